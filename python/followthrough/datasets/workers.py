# SPDX-License-Identifier: GPL-3.0-or-later
"""Items made in several processes, each on one thread. They stop when they are told to, and when their parent is gone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from followthrough import _core
from followthrough.datasets.manifest import Entry
from followthrough.datasets.recipes import Item

#: Makes an item's file; calls its second argument after every frame.
Work = Callable[[Item, Callable[[], None]], Entry]
#: Seconds between two looks at how far the processes have come.
_INTERVAL = 0.2

_frames: Any = None  # of this process, where it is a worker: frames done by all of them, and whether to stop
_stop: Any = None


class _Stopped(Exception):  # noqa: N818  # not an error
    """The parent wants no more."""


def run_all(
    work: Work,
    items: Sequence[Item],
    *,
    jobs: int,
    finished: Callable[[Item, Entry], None],
    frames_done: Callable[[int], None],
) -> None:
    """Work on every item.

    Parameters
    ----------
    work
        What to do; of plain values, because it is sent to the processes.
    items
        In the order in which they are begun.
    jobs
        Processes; 1 works in this one.
    finished
        Called in this process for every item, in the order in which they end.
    frames_done
        Called in this process with the number of frames since the last call.
    """
    if jobs == 1:
        _run_here(work, items, finished, frames_done)
        return
    # Not forked: threads of the core would not survive that.
    context = multiprocessing.get_context("spawn")
    frames, stop = context.Value("q", 0), context.Event()
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_become_worker, initargs=(frames, stop)) as pool:
        waiting: dict[Future[Entry], Item] = {}
        try:
            with _interrupts_held():
                for item in items:
                    waiting[pool.submit(_run_item, work, item)] = item
            seen = 0
            while waiting:
                done, _ = wait(waiting, timeout=_INTERVAL, return_when=FIRST_COMPLETED)
                for future in done:
                    entry = future.result()
                    finished(waiting.pop(future), entry)
                frames_done(frames.value - seen)
                seen = frames.value
        except BaseException as error:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            for future, item in waiting.items():  # what was finished meanwhile
                if not future.cancelled() and future.exception() is None:
                    finished(item, future.result())
            if isinstance(error, BrokenProcessPool):
                raise ChildProcessError("a worker process was killed (out of memory? try fewer jobs)") from None
            raise


def _run_here(
    work: Work,
    items: Sequence[Item],
    finished: Callable[[Item, Entry], None],
    frames_done: Callable[[int], None],
) -> None:
    threads = _core.threads()
    _core.set_threads(1)
    try:
        for item in items:
            finished(item, work(item, lambda: frames_done(1)))
    finally:
        _core.set_threads(threads)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Processes begun meanwhile are not interrupted before they can ignore it; an interrupt of ours comes afterwards."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _become_worker(frames: Any, stop: Any) -> None:
    global _frames, _stop
    _frames, _stop = frames, stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, which then stops us
    _core.set_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_item(work: Work, item: Item) -> Entry:
    return work(item, _frame_done)


def _frame_done() -> None:
    if _stop.is_set():
        raise _Stopped
    with _frames.get_lock():
        _frames.value += 1
