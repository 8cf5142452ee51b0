# SPDX-License-Identifier: GPL-3.0-or-later
"""A thread that works while Blender does."""

from __future__ import annotations

import concurrent.futures
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from followthrough import _core

#: Seconds after which the thread gets its turn while Python runs beside it; Python's own 5 ms would add up.
SWITCH_INTERVAL = 5e-4


@contextmanager
def work_beside_blender() -> Iterator[concurrent.futures.Executor]:
    """One thread, for work that touches nothing of Blender's. It has ended when the `with` block has; what has not begun then never will.
    What the core does on it in parallel leaves a processor to Blender.

    Blender lets other threads run while it changes the frame or runs an operator. If Python collected cyclic garbage on one of them, it
    would free its ends of data that Blender is at work on, which crashes Blender sooner or later; so none is collected in the block.
    """
    interval, collects = sys.getswitchinterval(), gc.isenabled()
    thread = concurrent.futures.ThreadPoolExecutor(max_workers=1, initializer=_leave_a_processor)
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        yield thread
    finally:
        thread.shutdown(wait=True, cancel_futures=True)
        sys.setswitchinterval(interval)
        if collects:
            gc.enable()


def _leave_a_processor() -> None:
    """To Blender: where it has one processor too few, the core's threads spin while they wait for each other."""
    _core.set_threads(max(1, _core.threads() - 1))
