# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures methods side by side: every one takes a frame before any takes the next, in rotating order.

Whatever slows the machine down for a while then slows all of them down, and ratios hold. The truth is stepped along with the rest.
"""

from __future__ import annotations

import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from followthrough import _core
from followthrough.benchmarking.methods import TRUTH, Method, MethodUnavailableError, truth_method
from followthrough.benchmarking.scene import Scene
from followthrough.character import FloatArray
from followthrough.evaluation import mean_square, root_mean
from followthrough.solver import Solver

#: A frame that takes longer than this many seconds is not waited for.
LONGEST_FRAME = 60.0
#: A method may take so many times its fair share of a size's seconds at most, and half of that for a frame.
MOST_SHARES = 2.0
#: Share of a size's seconds after which no further method is made; the frames get the rest.
MOST_SETUP = 0.6

Frames = Callable[[range], Iterable[int]]


@dataclass(frozen=True)
class Result:
    """What came of a method, at a size and a number of threads.

    Attributes
    ----------
    name, summary
        The method's.
    threads
        That it ran with.
    skipped
        Why it was not measured; None: it was, and the rest counts.
    ms_median, ms_low, ms_high
        Milliseconds a frame of the rollout: the median, and the 10th and 90th percentile.
    setup_ms
        Making it and its first frame, which is not among the others, in milliseconds.
    frames
        That it was measured in, and finite for.
    single_frame
        Root mean square error over all vertices (constrained ones included) and axes of every frame from true history, m; NaN where
        that says nothing about the method.
    rollout_24, rollout_all
        The same of the rollout, its first 24 frames and all; infinite where it exploded, None where there were fewer frames.
    largest
        The farthest that any vertex of the rollout is off, m.
    work
        What a frame took on average, by name.
    notes
        What the method warned of, and what there is to say about it.
    """

    name: str
    summary: str
    threads: int
    skipped: str | None = None
    ms_median: float = float("nan")
    ms_low: float = float("nan")
    ms_high: float = float("nan")
    setup_ms: float = float("nan")
    frames: int = 0
    single_frame: float = float("nan")
    rollout_24: float | None = None
    rollout_all: float = float("nan")
    largest: float = float("nan")
    work: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class SizeResult:
    """Everything at one size.

    Attributes
    ----------
    vertices, free_vertices, tets
        Counts.
    edge
        Of a cube, m.
    dimensionless_stiffness
        s = E h² / (rho L²).
    frames, frames_wanted
        Measured, and asked for.
    unconverged
        Frames in which the truth has not converged; errors are then without a firm ground.
    results
        A method and number of threads each.
    """

    vertices: int
    free_vertices: int
    tets: int
    edge: float
    dimensionless_stiffness: float
    frames: int
    frames_wanted: int
    unconverged: int
    results: list[Result]


@dataclass
class _Lane:
    """A method at a number of threads, while it is measured."""

    method: Method
    threads: int
    solver: Solver
    setup_ms: float
    notes: list[str]
    judged: bool  # errors are measured here, and not again with other numbers of threads
    positions: FloatArray
    exploded: bool = False
    stopped: bool = False
    spent: float = 0.0  # seconds
    milliseconds: list[float] = field(default_factory=list)
    rollout: list[float] = field(default_factory=list)
    single: list[float] = field(default_factory=list)
    largest: float = 0.0
    work: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))

    def step(self, reference: FloatArray, ahead: FloatArray | None) -> None:
        """A frame of the rollout, timed."""
        if self.exploded or self.stopped:
            return
        _core.set_threads(self.threads)
        begun = time.perf_counter()
        self.positions = self.solver.step(reference, ahead)
        seconds = time.perf_counter() - begun
        self.spent += seconds
        self.milliseconds.append(1000 * seconds)
        if self.threads > 1 and self.method.afterglow:
            time.sleep(self.method.afterglow)
        self.exploded = not np.isfinite(self.positions).all()
        for name, amount in self.method.work(self.solver).items():
            self.work[name] += amount

    def judge(self, truth: FloatArray, reference: FloatArray, ahead: FloatArray | None, frame: int) -> None:
        """The errors of a frame."""
        if self.stopped:
            return
        self.rollout.append(np.inf if self.exploded else mean_square(self.positions, truth[frame]))
        if not self.exploded:
            off = np.linalg.norm(self.positions - truth[frame], axis=1).max()
            self.largest = max(self.largest, float(off))
        if not self.judged:
            return
        _core.set_threads(self.threads)
        state = self.solver.state()
        begun = time.perf_counter()
        self.solver.resume(truth[:frame], reference[:frame])
        self.single.append(mean_square(self.solver.step(reference[frame], ahead), truth[frame]))
        self.spent += time.perf_counter() - begun
        if not self.exploded:
            self.solver.restore(state)

    def result(self, single_frame: float) -> Result:
        times = np.array(self.milliseconds)
        low, median, high = np.percentile(times, [10, 50, 90])
        return Result(
            name=self.method.name,
            summary=self.method.summary,
            threads=self.threads,
            ms_median=float(median),
            ms_low=float(low),
            ms_high=float(high),
            setup_ms=self.setup_ms,
            frames=int(np.isfinite(self.rollout).sum()),
            single_frame=single_frame,
            rollout_24=root_mean(self.rollout[:24]) if len(self.rollout) >= 24 else None,
            rollout_all=root_mean(self.rollout),
            largest=float("inf") if self.exploded else self.largest,
            work={name: amount / len(times) for name, amount in self.work.items()},
            notes=self.notes,
        )


def measure(
    scene: Scene,
    methods: list[Method],
    threads: list[int],
    seconds: float = float("inf"),
    progress: Frames = lambda frames: frames,
) -> SizeResult:
    """Measure methods on a scene.

    Parameters
    ----------
    methods
        In the order of the results. The truth is stepped in any case, and is among the results where it is one of these.
    threads
        Every method is timed with each of these numbers of threads.
    seconds
        Stops after the first frame that ends later than this. Leaves out methods that would take, and stops those that have taken,
        more than their share, and leaves out the last ones where making the others has taken too long. The truth is stepped in any
        case, but with one number of threads only where it would take more than its share.
    progress
        Wraps the range of frames, for example into a progress bar.

    Raises
    ------
    ValueError
        Where results depend on the number of threads.
    """
    begun = time.perf_counter()
    usual = _core.threads()
    try:
        lanes, skipped = _set_up(scene, methods, threads, begun, seconds)
        frames = _run(scene, lanes, begun, seconds, progress)
    finally:
        _core.set_threads(usual)
    sequence = scene.sequence
    singles = {lane.method.name: root_mean(lane.single) for lane in lanes if lane.judged}
    # The truth's own next frame is the truth.
    singles[TRUTH] = 0.0
    measured = {
        (lane.method.name, lane.threads): lane.result(singles.get(lane.method.name, float("nan"))) for lane in lanes
    }
    truth = _true_lane(lanes)
    return SizeResult(
        vertices=sequence.vertex_count,
        free_vertices=int(np.count_nonzero(~sequence.constrained)),
        tets=len(sequence.tets),
        edge=scene.edge,
        dimensionless_stiffness=scene.dimensionless_stiffness,
        frames=frames,
        frames_wanted=sequence.frame_count - 1,
        unconverged=round(truth.work["unconverged"]),
        results=[(skipped | measured)[method.name, number] for method in methods for number in threads],
    )


def _set_up(
    scene: Scene, methods: list[Method], threads: list[int], begun_all: float, seconds: float
) -> tuple[list[_Lane], dict[tuple[str, int], Result]]:
    reference = scene.sequence.reference
    wanted = [(method, number) for method in methods for number in threads]
    if all(method.name != TRUTH for method in methods):
        wanted.append((truth_method(), threads[-1]))
    longest = min(LONGEST_FRAME, max(MOST_SHARES / len(wanted) * seconds / 2, 0.0))
    lanes: list[_Lane] = []
    skipped: dict[tuple[str, int], Result] = {}
    for method, number in wanted:
        needed = method.name == TRUTH and number == threads[-1]
        if not needed and time.perf_counter() - begun_all > MOST_SETUP * seconds:
            reason = f"making the methods before it took {MOST_SETUP:.0%} of the time"
            skipped[method.name, number] = Result(method.name, method.summary, number, skipped=reason)
            continue
        _core.set_threads(number)
        try:
            begun = time.perf_counter()
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                solver = method.make(scene)
            expected = method.forecast(solver, scene) if method.forecast else 0.0
            if expected <= longest:
                solver.reset(reference[0])
                started = time.perf_counter()
                solver.step(reference[1], None)
                expected = time.perf_counter() - started
            setup = 1000 * (time.perf_counter() - begun)
        except MethodUnavailableError as error:
            skipped[method.name, number] = Result(method.name, method.summary, number, skipped=str(error))
            continue
        if expected > longest and not needed:
            reason = f"a frame takes {expected:.2g} s or more, and {longest:.2g} s fit the time"
            skipped[method.name, number] = Result(method.name, method.summary, number, skipped=reason)
            continue
        solver.reset(reference[0])
        judged = method.has_errors and method.name != TRUTH and all(lane.method.name != method.name for lane in lanes)
        notes = [*(str(w.message) for w in caught), *method.notes(solver)]
        lanes.append(_Lane(method, number, solver, setup, notes, judged, reference[0]))
    return lanes, skipped


def _run(scene: Scene, lanes: list[_Lane], begun: float, seconds: float, progress: Frames) -> int:
    reference = scene.sequence.reference
    count = scene.sequence.frame_count
    truth = np.empty_like(reference)
    truth[0] = reference[0]
    true_lane = _true_lane(lanes)
    done = 0
    for frame in progress(range(1, count)):
        ahead = reference[frame + 1] if frame + 1 < count else None
        first = frame % len(lanes)
        for lane in lanes[first:] + lanes[:first]:
            lane.step(reference[frame], ahead)
        truth[frame] = true_lane.positions
        if not np.isfinite(truth[frame]).all():
            raise ValueError(f"dynamic: found non-finite positions of the truth in frame {frame}, expected finite ones")
        for lane in lanes:
            lane.judge(truth, reference, ahead, frame)
        _require_same(lanes, frame)
        for lane in lanes:
            if lane is not true_lane and not lane.stopped and lane.spent > MOST_SHARES / len(lanes) * seconds:
                lane.stopped = True
        done = frame
        if time.perf_counter() > begun + seconds:
            break
    for lane in lanes:
        if len(lane.rollout) < done:
            lane.notes.append(
                f"stopped after {len(lane.rollout)} frames, as it had taken more than its share of the time; its errors are over these"
            )
    return done


def _true_lane(lanes: list[_Lane]) -> _Lane:
    """The one that the others are measured against: the last, which is there in any case."""
    return [lane for lane in lanes if lane.method.name == TRUTH][-1]


def _require_same(lanes: list[_Lane], frame: int) -> None:
    for before, lane in pairwise(lanes):
        if before.stopped or lane.stopped or not lane.method.same_bits:
            continue
        if before.method is lane.method and not np.array_equal(before.positions, lane.positions, equal_nan=True):
            raise ValueError(
                f"{lane.method.name}: found other positions in frame {frame} with {lane.threads} threads than with {before.threads}, "
                "expected the same bits (this is a bug)"
            )
