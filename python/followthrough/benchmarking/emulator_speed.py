# SPDX-License-Identifier: GPL-3.0-or-later
"""What the emulator is timed beside, and what follows from the times: `followthrough benchmark emulator` as a library."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core
from followthrough.benchmarking import measurement
from followthrough.benchmarking.measurement import Frames, Result, SizeResult
from followthrough.benchmarking.methods import (
    METHODS,
    TRUTH,
    Method,
    MethodUnavailableError,
    SkinningAlone,
    few_iterations,
    select,
)
from followthrough.benchmarking.runtimes import native_solver, runtime_methods
from followthrough.benchmarking.scene import Scene
from followthrough.character import FloatArray
from followthrough.emulator import Emulator, Precision
from followthrough.emulator_weights import EmulatorWeights
from followthrough.solver import Solver

PUBLISHED = "published"
BFLOAT16 = "published/bfloat16"
SHIPPED = "emulator/0"
RUNTIMES = ("pytorch", "onnx-runtime")
#: Sides of the square float32 matrices whose product is the peak.
SGEMM_SIDES = (512, 1024, 1536)
#: Seconds. For about a tenth OpenBLAS' threads spin before they sleep, and what runs beside them takes up to twice as long.
_OPENBLAS_WAITS = 0.12
#: Newton iterations between the qualities of the finite elements.
ITERATIONS = (1, 2, 3)


class MatrixProduct(SkinningAlone):
    """A float32 matrix product of NumPy's in the place of a frame, with the core's number of threads."""

    def __init__(self, side: int) -> None:
        from threadpoolctl import ThreadpoolController

        super().__init__()
        random = np.random.default_rng(0)
        self._left, self._right = (random.normal(size=(side, side)).astype(np.float32) for _ in range(2))
        self._product = np.empty_like(self._left)
        self._pools = ThreadpoolController()

    def step(self, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """Multiply."""
        with self._pools.limit(limits=_core.threads(), user_api="blas"):
            np.matmul(self._left, self._right, out=self._product)
        return super().step(reference)


def _sgemm(side: int) -> Method:
    def make(scene: Scene) -> Solver:
        if importlib.util.find_spec("threadpoolctl") is None:
            raise MethodUnavailableError("threadpoolctl not installed (pip install followthrough[benchmark])")
        return MatrixProduct(side)

    return Method(
        f"sgemm/{side}",
        f"NumPy's float32 product of {side} x {side} matrices",
        make,
        work=lambda solver: {"GFLOP": 2e-9 * side**3},
        has_errors=False,
        afterglow=_OPENBLAS_WAITS,
    )


def published_weights(seed: int = 0) -> EmulatorWeights:
    """Random weights of the published sizes, 237,571 parameters: a frame takes as long with these as with any."""
    random = np.random.default_rng(seed)
    parameters: dict[str, Any] = {}
    for name, widths in (
        ("point_mlp", (18, *(64,) * 5)),
        ("edge_mlp", (37, *(128,) * 5)),
        ("instance_mlp", (192, *(192,) * 4, 3)),
    ):
        for k, (inputs, outputs) in enumerate(pairwise(widths)):
            # So small a last layer that a rollout stays where it is.
            gain = 0.02 if outputs == 3 else 1.0
            weight = gain * random.normal(size=(outputs, inputs)) / math.sqrt(inputs)
            parameters[f"{name}.{2 * k}.weight"] = weight.astype(np.float32)
            parameters[f"{name}.{2 * k}.bias"] = (0.1 * gain * random.normal(size=outputs)).astype(np.float32)
    return EmulatorWeights(parameters)


def _published(weights: EmulatorWeights, name: str, precision: Precision) -> Method:
    def make(scene: Scene) -> Solver:
        try:
            return native_solver(scene, weights, precision)
        except ValueError as error:
            if "precision" not in str(error):
                raise
            raise MethodUnavailableError(str(error)) from None

    def work(solver: Emulator) -> Mapping[str, float]:
        return {"GFLOP": 2e-9 * solver.multiply_adds}

    summary = f"a network of the paper, {weights.parameter_count:,} parameters, native, {precision}"
    return Method(name, summary, make, work, has_errors=False)  # its weights may be random


def speed_methods(weights: EmulatorWeights) -> list[Method]:
    """All that is measured; `weights` are a network of the paper."""
    return [
        *(_sgemm(side) for side in SGEMM_SIDES),
        _published(weights, PUBLISHED, "float32"),
        _published(weights, BFLOAT16, "bfloat16"),
        *(method for method in METHODS if method.name == SHIPPED),
        *(few_iterations(most) for most in ITERATIONS),
        *select(["implicit-euler"]),
        *runtime_methods(weights),  # last: choosing batchings may take so long that nothing else is made
    ]


@dataclass(frozen=True)
class EqualError:
    """The finite elements' time at the shipped network's error, single frames from true history.

    Attributes
    ----------
    error
        m.
    ms
        Milliseconds a frame; a bound where `bound` says so.
    bound
        "": between two measured settings. "at most": the quickest setting measured is as exact already. "at least": none is so exact.
    """

    error: float
    ms: float
    bound: str


@dataclass(frozen=True)
class Speeds:
    """What follows from the times at a size and a number of threads; None where something was not measured.

    Attributes
    ----------
    threads
        That it ran with.
    peak_gflops
        The fastest matrix product's, 10⁹ operations a second, a multiply-add being two.
    gflops, share_of_peak
        The native kernel's on the published network, of the multiply-adds that remain after the exact savings.
    over_pytorch, over_onnx_runtime
        Their time over the native kernel's.
    bfloat16_over_pytorch, bfloat16_over_onnx_runtime
        The same over that of the native kernel in bfloat16.
    shipped_share
        The shipped network's time over the published one's.
    speed_up, shipped_speed_up
        Time with one thread over that with these, of the published and of the shipped network.
    equal_error
        The finite elements at the shipped network's error.
    over_finite_elements
        Their time there over the shipped network's: above 1 the network wins.
    """

    threads: int
    peak_gflops: float | None
    gflops: float | None
    share_of_peak: float | None
    over_pytorch: float | None
    over_onnx_runtime: float | None
    bfloat16_over_pytorch: float | None
    bfloat16_over_onnx_runtime: float | None
    shipped_share: float | None
    speed_up: float | None
    shipped_speed_up: float | None
    equal_error: EqualError | None
    over_finite_elements: float | None


def measure_speed(
    scene: Scene, weights: EmulatorWeights, threads: list[int], seconds: float, progress: Frames
) -> SizeResult:
    """Time everything on a scene, interleaved (`measurement.measure`)."""
    return measurement.measure(scene, speed_methods(weights), threads, seconds, progress)


def speeds(size: SizeResult) -> list[Speeds]:
    """What follows, by number of threads."""
    return [_speeds(size, threads) for threads in dict.fromkeys(result.threads for result in size.results)]


def _speeds(size: SizeResult, threads: int) -> Speeds:
    measured = {(result.name, result.threads): result for result in size.results if result.skipped is None}

    def milliseconds(name: str, number: int = threads) -> float | None:
        result = measured.get((name, number))
        return None if result is None else result.ms_median

    def rate(name: str) -> float | None:
        result = measured.get((name, threads))
        return None if result is None else gflops(result)

    peaks = [value for value in (rate(f"sgemm/{side}") for side in SGEMM_SIDES) if value is not None]
    peak = max(peaks, default=None)
    published, shipped = milliseconds(PUBLISHED), milliseconds(SHIPPED)
    equal = equal_error(list(measured.values()), threads)
    return Speeds(
        threads=threads,
        peak_gflops=peak,
        gflops=rate(PUBLISHED),
        share_of_peak=_ratio(rate(PUBLISHED), peak),
        over_pytorch=_ratio(milliseconds("pytorch"), published),
        over_onnx_runtime=_ratio(milliseconds("onnx-runtime"), published),
        bfloat16_over_pytorch=_ratio(milliseconds("pytorch"), milliseconds(BFLOAT16)),
        bfloat16_over_onnx_runtime=_ratio(milliseconds("onnx-runtime"), milliseconds(BFLOAT16)),
        shipped_share=_ratio(shipped, published),
        speed_up=_ratio(milliseconds(PUBLISHED, 1), published),
        shipped_speed_up=_ratio(milliseconds(SHIPPED, 1), shipped),
        equal_error=equal,
        over_finite_elements=None if equal is None else _ratio(equal.ms, shipped),
    )


def gflops(result: Result) -> float | None:
    """10⁹ operations a second of a method that counts them."""
    return _ratio(result.work.get("GFLOP"), result.ms_median / 1000)


def _ratio(above: float | None, below: float | None) -> float | None:
    return None if above is None or not below else above / below


def equal_error(results: SequenceOf[Result], threads: int) -> EqualError | None:
    """The finite elements' time at the shipped network's error; log time over log error is a line between measured settings."""
    error = next((r.single_frame for r in results if r.name == SHIPPED and math.isfinite(r.single_frame)), None)
    if not error:
        return None
    elements = [r for r in results if r.name.startswith("implicit-euler/") and r.threads == threads]
    settings = sorted(
        (r.single_frame, r.ms_median)
        for r in elements
        if r.name != TRUTH and math.isfinite(r.single_frame) and r.single_frame > 0
    )
    # The quickest settings for their error alone: others would never be chosen.
    curve = [(e, ms) for k, (e, ms) in enumerate(settings) if all(ms < other for _, other in settings[:k])]
    if not curve:
        return None
    if error >= curve[-1][0]:
        return EqualError(error, curve[-1][1], "at most")
    if error <= curve[0][0]:
        return EqualError(error, curve[0][1], "at least")
    (low, slow), (high, quick) = next(pair for pair in pairwise(curve) if pair[0][0] <= error <= pair[1][0])
    share = math.log(error / low) / math.log(high / low)
    return EqualError(error, math.exp((1 - share) * math.log(slow) + share * math.log(quick)), "")
