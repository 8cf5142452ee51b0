# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress bars on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any, Self, TypeVar

Item = TypeVar("Item")


def with_progress(items: Iterable[Item], description: str, unit: str = "frame", quiet: bool = False) -> Iterable[Item]:
    """Show how far the caller has come through `items`, with the time left."""
    if quiet:
        return items
    bar: Iterable[Item] = _bars()(items, desc=description, unit=f" {unit}", file=sys.stderr)
    return bar


def _bars() -> Any:
    from tqdm import tqdm

    tqdm.monitor_interval = 0  # no thread beside Blender (`blender/work_beside.py`)
    return tqdm


class ProgressBar:
    """How far work has come whose size is known only once it begins, with the time left. Leave the `with` block to end it."""

    def __init__(self, description: str, unit: str = "frame", quiet: bool = False) -> None:
        self._description, self._unit, self._quiet = description, unit, quiet
        self._bar: Any = None

    def begin(self, total: int) -> None:
        """There are so many units of work."""
        if not self._quiet and total > 0:
            self._bar = _bars()(total=total, desc=self._description, unit=f" {self._unit}", file=sys.stderr)

    def advance(self, units: int) -> None:
        """So many more are done."""
        if self._bar is not None and units > 0:
            self._bar.update(units)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()
