# SPDX-License-Identifier: GPL-3.0-or-later
"""The manifest of a data set: how it was made, and every file that is finished, with its hash."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

from followthrough import __version__
from followthrough.datasets.recipes import Recipe, Setting
from followthrough.npz_files import written_whole

#: Name of its file.
FILE_NAME = "manifest.json"
#: What the file says that it is.
_FORMAT = "followthrough data set 1"
_WHAT_MAKES_IT = ("kind", "recipe_version", "seed", "precision", "settings")


@dataclass(frozen=True)
class Entry:
    """A sequence that is finished.

    Attributes
    ----------
    motion : int
        Which motion it shows.
    frames : int
        How many frames it has; 0 where there is no file.
    sha256 : str or None
        Of the file; None where too few frames converged to be of use, and no file was written.
    size : int
        Of the file, bytes.
    worst_residual : float
        Relative, of its steps.
    tried_again : list of int
        Frames that converged only with more iterations.
    stopped_at : int or None
        The frame that did not converge; the sequence ends before it.
    stopped_residual : float or None
        What its residual was.
    facts : dict
        What the recipe says of it.
    """

    motion: int
    frames: int
    sha256: str | None
    size: int
    worst_residual: float
    tried_again: list[int]
    stopped_at: int | None = None
    stopped_residual: float | None = None
    facts: dict[str, Setting] = field(default_factory=dict)


@dataclass(eq=False)
class Manifest:
    """How a data set was made, and what is there of it.

    Attributes
    ----------
    kind, recipe_version, seed, settings
        Of the recipe.
    precision : str
        "float32" or "float64": what positions are stored in.
    motions : int
        How many motions were asked for.
    followthrough : str
        The version that began it.
    files : dict
        Entries by file name.
    """

    kind: str
    recipe_version: int
    seed: int
    precision: str
    settings: dict[str, Setting]
    motions: int
    followthrough: str = __version__
    files: dict[str, Entry] = field(default_factory=dict)

    @classmethod
    def begin(cls, recipe: Recipe, precision: str, motions: int) -> Self:
        """The manifest of a data set of which nothing is there yet."""
        settings = json.loads(json.dumps(recipe.settings()))  # as it will be read back
        return cls(recipe.kind, recipe.version, recipe.seed, precision, settings, motions)

    @classmethod
    def load(cls, directory: Path) -> Self:
        """Read a data set's manifest.

        Raises
        ------
        ValueError
            Where it is missing or no such manifest; names the file.
        """
        path = directory / FILE_NAME
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ValueError(f"{path}: found no such file, expected the manifest of a data set") from None
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise ValueError(f"{path}: found no readable manifest of a data set ({error})") from None
        if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
            raise ValueError(f"{path}: found another format, expected {_FORMAT!r}")
        try:
            files = {str(name): Entry(**entry) for name, entry in content.pop("files").items()}
            return cls(**content, files=files)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{path}: found an incomplete manifest of a data set ({error})") from None

    def save(self, directory: Path) -> None:
        """Write it into the data set's folder, all or nothing."""
        content: dict[str, Any] = {"format": _FORMAT, **asdict(self)}
        content["files"] = {name: content["files"][name] for name in sorted(content["files"])}
        with written_whole(directory / FILE_NAME) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def require_same(self, other: Manifest, directory: Path) -> None:
        """Refuse to continue a data set that was begun with other settings.

        Raises
        ------
        ValueError
            Naming what differs.
        """
        for name in _WHAT_MAKES_IT:
            found, expected = getattr(self, name), getattr(other, name)
            if name == "settings" and isinstance(found, dict):
                keys = [key for key in {**found, **expected} if found.get(key) != expected.get(key)]
                if keys:
                    name, found, expected = keys[0], found.get(keys[0]), expected.get(keys[0])
            if found != expected:
                raise ValueError(
                    f"{directory}: found another data set ({name} {found}), expected an empty folder or one with "
                    f"{name} {expected} (choose another folder, or the settings that it was begun with)"
                )

    def intact(self, directory: Path, names: Iterable[str]) -> set[str]:
        """Those of the files that are there as they were written, or that have none to be there."""
        return {
            name
            for name in names
            if name in self.files
            and (
                self.files[name].sha256 is None
                or ((directory / name).is_file() and file_hash(directory / name) == self.files[name].sha256)
            )
        }


def file_hash(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
