# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator's benchmark says what follows from its times, and goes on without what is not installed."""

import json
import math
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from followthrough import _core, cli
from followthrough.benchmarking import emulator_speed, measurement
from followthrough.benchmarking.emulator_speed import (
    BFLOAT16,
    PUBLISHED,
    SHIPPED,
    equal_error,
    published_weights,
    speeds,
)
from followthrough.benchmarking.measurement import Result, SizeResult
from followthrough.benchmarking.methods import TRUTH, Method, SkinningAlone, few_iterations, truth_method
from followthrough.benchmarking.runtimes import Batching, chunks
from followthrough.benchmarking.scene import make_scene, make_scene_of_free
from followthrough.benchmarking.whole_frame import PARTS, measure_whole_frame
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights


def run(*words: str) -> int:
    return cli.main(["benchmark", "emulator", "--quiet", "--sizes", "300", "--frames", "4", *words])


def timed(name: str, ms: float, error: float = math.nan, threads: int = 1, **work: float) -> Result:
    return Result(name, "", threads, ms_median=ms, single_frame=error, work=work)


def test_the_finite_elements_time_is_read_off_where_their_error_is_the_networks() -> None:
    quick, slow = timed("implicit-euler/1", 1.0, 1e-2), timed("implicit-euler/fine", 4.0, 1e-4)
    waste = timed("implicit-euler/preview", 9.0, 1e-3)  # less exact and slower than fine: nobody would choose it
    truth = timed(TRUTH, 20.0, 0.0)
    curve = [quick, waste, slow, truth]
    between = equal_error([*curve, timed(SHIPPED, 1.0, 1e-3)], 1)
    assert between is not None and (between.ms, between.bound) == (pytest.approx(2.0), "")
    exact = equal_error([*curve, timed(SHIPPED, 1.0, 1e-5)], 1)
    assert exact is not None and (exact.ms, exact.bound) == (4.0, "at least")
    crude = equal_error([*curve, timed(SHIPPED, 1.0, 1.0)], 1)
    assert crude is not None and (crude.ms, crude.bound) == (1.0, "at most")
    assert equal_error(curve, 1) is None


def test_ratios_are_those_of_the_times() -> None:
    results = [
        timed("sgemm/512", 1.0, GFLOP=0.1),
        timed("sgemm/1024", 4.0, GFLOP=0.2),
        timed(PUBLISHED, 10.0, GFLOP=0.5),
        timed(PUBLISHED, 6.0, threads=2, GFLOP=0.5),
        timed(BFLOAT16, 5.0),
        timed("pytorch", 50.0),
        timed(SHIPPED, 2.0, 1e-3),
    ]
    size = SizeResult(300, 250, 900, 0.2, 1.0, 4, 4, 0, results)
    one, two = speeds(size)
    assert (one.peak_gflops, one.gflops, one.share_of_peak) == pytest.approx((100.0, 50.0, 0.5))
    assert one.over_pytorch == pytest.approx(5.0) and one.over_onnx_runtime is None
    assert one.bfloat16_over_pytorch == pytest.approx(10.0) and one.bfloat16_over_onnx_runtime is None
    assert one.shipped_share == pytest.approx(0.2)
    assert (two.speed_up, two.peak_gflops, two.shipped_share) == (pytest.approx(10 / 6), None, None)


@pytest.mark.parametrize("layout", ["padded", "by degree"])
@pytest.mark.parametrize("size", [2, None])
def test_every_vertex_is_in_one_chunk_with_all_its_neighbours(layout: str, size: int | None) -> None:
    table = np.array([[1, 2, -1], [0, 2, 3], [0, -1, -1], [1, 2, -1], [4, 0, 1]])
    cut = list(chunks(table, Batching(layout, size)))
    assert sorted(np.concatenate([rows for rows, _ in cut])) == list(range(5))
    for rows, near in cut:
        assert size is None or len(rows) <= size
        assert layout == "padded" or (near >= 0).all()
        for row, found in zip(rows, near, strict=True):
            assert list(found[found >= 0]) == list(table[row][table[row] >= 0])


def test_sizes_are_free_vertices() -> None:
    for free in (400, 2000):
        assert np.count_nonzero(~make_scene_of_free(free, 4).sequence.constrained) == pytest.approx(free, rel=0.05)


def test_the_timed_network_has_the_published_size() -> None:
    assert published_weights().parameter_count == 237_571


def test_one_json_object_and_a_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "speed.png"
    assert run("--threads", "1", "2", "--json", "--plot", str(picture)) == 0
    values = json.loads(capsys.readouterr().out)
    (size,) = values["sizes"]
    assert size["free_vertices"] == pytest.approx(300, rel=0.15)
    results = {(result["name"], result["threads"]): result for result in size["results"]}
    for name in (PUBLISHED, SHIPPED, "implicit-euler/fine"):
        assert results[name, 1]["us_a_free_vertex"] == pytest.approx(
            1000 * results[name, 1]["ms_median"] / size["free_vertices"]
        )
    assert [speed["threads"] for speed in size["speeds"]] == [1, 2]
    assert size["speeds"][1]["speed_up"] > 0 and size["speeds"][0]["gflops"] > 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [frame["threads"] for frame in values["whole_frames"]] == [1, 2]
    assert all(set(frame["parts"]) == set(PARTS) for frame in values["whole_frames"])


def test_a_whole_frame_is_measured_with_its_parts() -> None:
    (found,) = measure_whole_frame([1], 5, sides=8)
    assert found.surface_vertices == 14 * (8 * 8 + 2) and found.frames == 5
    assert 0 < found.free_vertices < found.volume_vertices
    assert 0 < found.ms_low <= found.ms_median <= found.ms_high
    assert list(found.parts) == list(PARTS) and min(found.parts.values()) > 0
    # The pass does what the parts do, and hardly anything else.
    assert found.parts["step"] < 2 * found.ms_median


def test_large_sizes_end_in_time_with_the_truth_of_one_number_of_threads() -> None:
    class Slow(SkinningAlone):
        def reset(self, reference: Any) -> Any:
            time.sleep(0.2)
            return super().reset(reference)

    scene = make_scene(300, 5)
    slow = [Method(f"slow/{k}", "", lambda scene: Slow()) for k in range(8)]
    begun = time.perf_counter()
    size = measurement.measure(scene, [*slow, few_iterations(1), truth_method()], [1, 2], seconds=1.0)
    assert time.perf_counter() - begun < 10.0
    results = {(result.name, result.threads): result for result in size.results}
    assert results["slow/0", 1].skipped is None
    late = "making the methods before it took 60% of the time"
    assert results["slow/7", 2].skipped == results["implicit-euler/1", 1].skipped == results[TRUTH, 1].skipped == late
    truth = results[TRUTH, 2]
    assert truth.skipped is None and truth.frames == size.frames >= 1


def test_what_is_not_installed_is_said_and_the_rest_measured(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        import torch  # noqa: F401
    except ImportError:
        assert run("--threads", "1") == 0
        printed = capsys.readouterr().out
        assert "pytorch was left out: torch not installed (pip install followthrough[benchmark])" in printed
        assert "onnx-runtime was left out: torch" in printed
        assert f"| {PUBLISHED} | 1 |" in printed
    else:
        pytest.skip("PyTorch is installed")


def test_an_interrupt_shows_the_sizes_that_are_whole(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = measurement.measure

    def interrupted_later(scene: Any, *rest: Any) -> SizeResult:
        if scene.sequence.vertex_count > 500:
            raise KeyboardInterrupt
        return measure(scene, *rest)

    monkeypatch.setattr(emulator_speed.measurement, "measure", interrupted_later)
    assert cli.main("benchmark emulator --quiet --sizes 300 800 --frames 4 --threads 1".split()) == 130
    said = capsys.readouterr()
    assert "Left out: 800 free vertices, as the run was interrupted." in said.out and f"| {PUBLISHED} |" in said.out
    assert run("--sizes", "800") == 130
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--sizes", "100"], "--sizes: found 100, expected 200 or more"),
        (["--frames", "1"], "--frames: found 1, expected 4 or more"),
        (["--threads", "0"], "--threads: found 0"),
        (["--seconds", "nan"], "--seconds: found nan"),
        (["--plot", "/no/such/folder/speed.png"], "is no folder"),
        (["--plot", "speed.txt"], "expected a name that ends in .png"),
    ],
)
def test_bad_options_are_named(words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*words) == 2
    said = capsys.readouterr()
    assert complaint in said.err and said.out == ""


def test_weights_of_another_network_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    from followthrough.emulator_weights import SHIPPED as SHIPPED_FILE

    assert run("--weights", str(SHIPPED_FILE)) == 2
    assert "holds a guided-newton network, expected a patch network of one ring" in capsys.readouterr().err


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="no such count of memory on this system")
@pytest.mark.filterwarnings("ignore:stiffness")
@pytest.mark.parametrize("network", ["published", "shipped"])
def test_memory_does_not_grow_with_frames(network: str) -> None:
    weights = published_weights() if network == "published" else EmulatorWeights.shipped()
    scene = make_scene(300, 24)
    reference = scene.sequence.reference
    solver = Emulator.of_sequence(scene.sequence, weights, edge_length=scene.edge)
    usual = _core.threads()
    _core.set_threads(1)

    def go(frames: int) -> None:
        solver.reset(reference[0])
        for frame in range(frames):
            solver.step(reference[frame % 24])

    try:
        go(200)
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        resident = resident_bytes()
        go(2000)
        grown = resident_bytes() - resident
        held, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        _core.set_threads(usual)
    positions = reference[0].nbytes
    assert grown < 100 * positions  # a leak of one frame's positions would be 2,000 of them
    assert held - before < 2 * positions + 20_000
    assert peak - before < 6 * positions + 50_000  # arrays that go in and out of a step, and no more
