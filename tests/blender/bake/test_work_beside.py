# SPDX-License-Identifier: GPL-3.0-or-later
"""What works on a thread while Blender does."""

from __future__ import annotations

import gc
import sys
import threading
import time

import pytest

from followthrough import _core
from followthrough.blender.work_beside import work_beside_blender


class Knot:
    """Garbage that only a collection finds; it notes the thread that frees it."""

    def __init__(self, freed_on: list[threading.Thread]) -> None:
        self.itself, self.freed_on = self, freed_on

    def __del__(self) -> None:
        self.freed_on.append(threading.current_thread())


def test_no_garbage_is_collected_on_the_thread():
    freed_on: list[threading.Thread] = []
    threshold = gc.get_threshold()
    gc.collect()
    gc.set_threshold(10, 1, 1)
    try:
        with work_beside_blender() as thread:
            Knot(freed_on)
            kept = thread.submit(lambda: [[] for _ in range(10_000)]).result()
            assert len(kept) == 10_000
            assert not freed_on
        kept = [[] for _ in range(10_000)]
        assert freed_on == [threading.main_thread()]
    finally:
        gc.set_threshold(*threshold)


@pytest.mark.parametrize("collects", [True, False])
def test_everything_is_as_before_after_an_error_too(collects):
    interval = sys.getswitchinterval()
    (gc.enable if collects else gc.disable)()
    try:
        with pytest.raises(ValueError, match="found nothing"), work_beside_blender():
            raise ValueError("found nothing")
        assert gc.isenabled() == collects
    finally:
        gc.enable()
    assert sys.getswitchinterval() == pytest.approx(interval)


def test_the_core_leaves_a_processor_to_blender():
    usual: list[int] = []
    other = threading.Thread(target=lambda: usual.append(_core.threads()))
    other.start()
    other.join()
    here = _core.threads()
    with work_beside_blender() as thread:
        assert thread.submit(_core.threads).result() == max(1, usual[0] - 1)
    assert _core.threads() == here


def test_what_has_begun_ends_with_the_block_and_the_rest_never_begins():
    began, done = threading.Event(), []

    def work() -> None:
        began.set()
        time.sleep(0.05)
        done.append("first")

    with work_beside_blender() as thread:
        thread.submit(work)
        later = thread.submit(done.append, "second")
        began.wait()
    assert done == ["first"]
    assert later.cancelled()
