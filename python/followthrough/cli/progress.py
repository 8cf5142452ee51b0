# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress bars on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TypeVar

Item = TypeVar("Item")


def with_progress(items: Iterable[Item], description: str, unit: str = "frame", quiet: bool = False) -> Iterable[Item]:
    """Show how far the caller has come through `items`, with the time left."""
    if quiet:
        return items
    from tqdm import tqdm

    bar: Iterable[Item] = tqdm(items, desc=description, unit=f" {unit}", file=sys.stderr)
    return bar
