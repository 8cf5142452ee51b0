# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy archives (.npz) without pickle: foreign and damaged files are refused by name, nothing is ever half-written."""

from __future__ import annotations

import io
import os
import struct
import tempfile
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: What zipfile and NumPy raise on files that are cut short, damaged, encrypted or of another format.
_DAMAGE = (
    ValueError,
    EOFError,
    OSError,
    KeyError,
    RuntimeError,
    MemoryError,
    OverflowError,
    SyntaxError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(path: Path | str) -> dict[str, NDArray[Any]]:
    """Read every array of an archive.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    dict
        Arrays by name, as the file orders them.

    Raises
    ------
    ValueError
        Where the file is missing, damaged, no archive, or holds something else than plain arrays, naming the file.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path}: found a folder, expected an .npz file")
    try:
        file = path.open("rb")
    except FileNotFoundError:
        raise ValueError(f"{path}: found no such file, expected an .npz file") from None
    with file:  # NumPy leaves a file open that it cannot read
        try:
            beginning = file.read(2)
            if beginning not in (b"PK", b"\x93N"):  # of a zip file, of a single array
                raise ValueError("it begins as no zip file does" if beginning else "it is empty")
            file.seek(0)
            archive = np.load(file, allow_pickle=False)
        except _DAMAGE as error:
            raise ValueError(
                f"{path}: found no readable .npz archive, perhaps cut short or of another format ({error})"
            ) from None
        if not isinstance(archive, np.lib.npyio.NpzFile):
            raise ValueError(f"{path}: found a single array, expected an .npz archive of several named ones")
        with archive:
            return {name: _read_array(path, archive, name) for name in archive.files}


def _read_array(path: Path, archive: Any, name: str) -> NDArray[Any]:
    try:
        array = archive[name]
    except _DAMAGE as error:
        if "Object arrays" in str(error):
            raise ValueError(f"{path}: {name}: found Python objects, expected plain numbers") from None
        raise ValueError(f"{path}: {name}: found no readable array, perhaps cut short ({error})") from None
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{path}: {name}: found something else than an array")
    return array


def require_output_folder(path: Path | str) -> Path:
    """Check that a file can be made at this path, before the work starts.

    Raises
    ------
    ValueError
        Where its folder is missing or not writable, or the path is a folder itself.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path}: found a folder, expected the name of the file to write")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: its folder {path.parent} is not there; make it first")
    if not os.access(path.parent, os.W_OK):
        raise ValueError(f"{path}: its folder {path.parent} cannot be written to")
    return path


@contextmanager
def written_whole(path: Path | str) -> Iterator[Path]:
    """Give a temporary file beside `path` that takes its place at the end, or is removed where anything goes wrong."""
    path = require_output_folder(path)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        temporary.chmod(0o666 & ~mask)  # mkstemp's own files are private
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_npz(path: Path | str, arrays: Mapping[str, NDArray[Any]], compressed: bool = True) -> None:
    """Write arrays under their names, all or nothing.

    Raises
    ------
    ValueError
        Where the folder is missing.
    """
    with written_whole(path) as temporary:
        # Not straight to the file: interrupted, NumPy's archive would still want to finish it after it is closed, and complain.
        archive = io.BytesIO()
        save = np.savez_compressed if compressed else np.savez
        save(archive, **{name: np.asarray(array) for name, array in arrays.items()})
        temporary.write_bytes(archive.getbuffer())
