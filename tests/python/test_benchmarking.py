# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark measures what it says, side by side."""

import json
import math
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough import _core, cli, emulator_weights, mesh
from followthrough.benchmarking import measurement, methods, plot
from followthrough.benchmarking.measurement import Result, measure
from followthrough.benchmarking.methods import METHODS, TRUTH, Method, MethodUnavailableError, SkinningAlone, select
from followthrough.benchmarking.scene import Scene, make_scene
from followthrough.emulator_weights import EmulatorWeights
from followthrough.evaluation import evaluate
from followthrough.simulation import simulate

sys.path.insert(0, str(Path(__file__).parent))
from plain_network import random_parameters

FRAMES = 5


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(300, FRAMES)


def by_name(results: list[Result]) -> dict[str, Result]:
    return {result.name: result for result in results}


@pytest.mark.parametrize("vertices", [400, 1500, 6000])
def test_the_dancer_is_whole_at_any_size(vertices: int) -> None:
    scene = make_scene(vertices, 48)
    sequence = scene.sequence
    assert sequence.vertex_count == pytest.approx(vertices, rel=0.04)
    assert np.array_equal(sequence.reference[0], sequence.rest_positions)
    parts = mesh.connected_parts(sequence.tets, sequence.vertex_count)
    assert parts.max() == 0
    assert np.ptp(sequence.rest_positions, axis=0).max() == pytest.approx(5.0, abs=2.5 * scene.edge)
    assert 0.03 < sequence.constrained.mean() < 0.2
    speed = np.linalg.norm(np.diff(sequence.reference, axis=0), axis=-1).max(axis=1)
    assert speed.max() > 0.8  # turns and jumps
    assert speed.min() == 0  # and stops
    assert np.argmax(speed) < 16  # within the frames that a large size reaches
    rested = sequence.reference[1:][speed == 0]
    assert np.linalg.norm(rested[0] - sequence.rest_positions, axis=-1).mean() > 0.2


def test_finer_meshes_pose_the_same_body() -> None:
    coarse, fine = (make_scene(vertices, 20).sequence for vertices in (700, 6000))
    for frame in (7, 20):
        centres = [sequence.reference[frame][sequence.constrained].mean(axis=0) for sequence in (coarse, fine)]
        assert np.linalg.norm(centres[0] - centres[1]) < 0.15


@pytest.mark.filterwarnings("ignore:stiffness")  # the scene is softer than what the emulator has learned
def test_errors_are_those_of_evaluate(scene: Scene) -> None:
    results = by_name(measure(scene, list(METHODS), [1]).results)
    assert list(results) == [method.name for method in METHODS]
    truth = simulate(scene.sequence, methods.truth_method().make(scene))
    for method in METHODS:
        if results[method.name].skipped:
            continue
        scores, result = evaluate(truth, method.make(scene)), results[method.name]
        assert (result.single_frame, result.rollout_all) == (scores.single_frame, scores.rollout_all)
        assert result.frames == FRAMES and result.rollout_24 is None
        assert 0 < result.ms_low <= result.ms_median <= result.ms_high
        assert result.largest >= result.rollout_all
    assert results[TRUTH].largest == 0 < results["implicit-euler/fine"].largest
    assert results["implicit-euler/fine"].rollout_all < results["skinning"].rollout_all
    assert results["central-differences/stable"].work["substeps"] > 1


@dataclass
class Log:
    """Who stepped, in order."""

    steps: list[str]


def logged(name: str, log: Log, after: Any = lambda frame, positions: positions) -> Method:
    class Logged(SkinningAlone):
        frame = 0

        def reset(self, reference: Any) -> None:
            self.frame = 0
            super().reset(reference)

        def step(self, reference: Any, next_reference: Any = None) -> NDArray[np.float64]:
            self.frame += 1
            log.steps.append(name)
            return after(self.frame, super().step(reference))

        def resume(self, dynamic: Any, reference: Any) -> None:
            log.steps.append(f"resume {name}")
            super().resume(dynamic, reference)

    return Method(name, "for tests", lambda scene: Logged())


def test_every_method_takes_a_frame_before_any_takes_the_next(scene: Scene) -> None:
    log = Log([])
    measure(scene, [logged(name, log) for name in "abc"], [1])
    assert log.steps[:3] == ["a", "b", "c"]  # set up
    rounds = [log.steps[3 + 9 * frame : 12 + 9 * frame] for frame in range(FRAMES)]
    for steps in rounds:
        assert sorted(steps[:3]) == ["a", "b", "c"]
        assert steps[3:] == ["resume a", "a", "resume b", "b", "resume c", "c"]
    assert len({tuple(steps[:3]) for steps in rounds}) == 3  # another one goes first each time


def test_an_explosion_is_reported_and_the_rest_goes_on(scene: Scene) -> None:
    def explode(steps: int, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        return positions * np.inf if steps == 3 else positions

    log = Log([])
    results = by_name(measure(scene, [logged("bomb", log, explode), logged("calm", log)], [1]).results)
    assert results["bomb"].frames == 1  # its third step is the rollout's second
    assert results["bomb"].rollout_all == results["bomb"].largest == math.inf
    assert results["calm"].frames == FRAMES and math.isfinite(results["calm"].rollout_all)


def test_what_cannot_run_or_takes_too_long_is_skipped_with_a_reason(scene: Scene) -> None:
    def unavailable(scene: Scene) -> SkinningAlone:
        raise MethodUnavailableError("no weights were found (pass --weights)")

    slow = Method("slow", "", lambda scene: SkinningAlone(), forecast=lambda solver, scene: 90.0)
    results = by_name(measure(scene, [Method("absent", "", unavailable), slow, *select(["springs"])], [1, 2]).results)
    assert results["absent"].skipped == "no weights were found (pass --weights)"
    assert results["slow"].skipped is not None and "takes 90 s or more, and 60 s fit" in results["slow"].skipped
    assert results["springs"].skipped is None
    within = by_name(measure(scene, [replace(slow, forecast=lambda solver, scene: 59.0)], [1]).results)
    assert within["slow"].skipped is None


def test_a_method_that_takes_more_than_its_share_is_stopped(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measurement, "MOST_SHARES", 0.03)

    def wait(steps: int, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        time.sleep(0.1)
        return positions

    log = Log([])
    results = by_name(measure(scene, [logged("slow", log, wait), logged("quick", log)], [1], seconds=30.0).results)
    assert results["slow"].frames == 2  # two steps a frame, and 0.3 s of 30
    assert results["slow"].notes[0].startswith("stopped after 2 frames")
    assert results["quick"].frames == FRAMES and not results["quick"].notes


def test_results_that_depend_on_threads_are_an_error(scene: Scene) -> None:
    class Racy(SkinningAlone):
        def step(self, reference: Any, next_reference: Any = None) -> NDArray[np.float64]:
            return super().step(reference) + 1e-16 * _core.threads()

    usual = _core.threads()
    with pytest.raises(ValueError, match="racy: found other positions in frame 1 with 2 threads than with 1"):
        measure(scene, [Method("racy", "", lambda scene: Racy())], [1, 2])
    assert _core.threads() == usual
    measure(scene, select(["springs", "implicit-euler/fine"]), [1, 2])


def test_methods_are_chosen_by_name_or_solver() -> None:
    assert select(None) == list(METHODS)
    assert [method.name for method in select(["implicit-euler", "skinning"])] == [
        "skinning",
        "implicit-euler/preview",
        "implicit-euler/fine",
        TRUTH,
    ]
    with pytest.raises(ValueError, match="solvers: found nonsense, expected some of skinning, springs"):
        select(["nonsense"])


def run(*words: str) -> int:
    return cli.main(["benchmark", "--quiet", "--sizes", "300", "--frames", "3", *words])


def test_one_json_object_a_table_and_a_plot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    folder = tmp_path / "new"
    assert run("--solvers", "skinning", "implicit-euler", "--threads", "1", "2", "--json", "-o", str(folder)) == 0
    printed = capsys.readouterr().out
    values = json.loads(printed)
    assert json.loads((folder / "benchmark.json").read_text()) == values
    assert sorted(values) == ["left_out", "machine", "scene", "sizes"]
    assert values["machine"]["cores"] >= 1 and values["machine"]["processor"]
    (size,) = values["sizes"]
    assert (size["frames"], size["frames_wanted"], size["unconverged"]) == (3, 3, 0)
    assert [(result["name"], result["threads"]) for result in size["results"]][:3] == [
        ("skinning", 1),
        ("skinning", 2),
        ("implicit-euler/preview", 1),
    ]
    table = (folder / "benchmark.md").read_text()
    rows = [line for line in table.splitlines() if line.startswith("| ")]
    assert len(rows) == 2 + 8 and len({row.count("|") for row in rows}) == 1
    assert (folder / "benchmark.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in folder.iterdir()) == ["benchmark.json", "benchmark.md", "benchmark.png"]


def test_without_matplotlib_there_is_no_plot_and_a_word_about_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plot.importlib.util, "find_spec", lambda name: None)
    assert run("--solvers", "springs", "-o", str(tmp_path)) == 0
    said = capsys.readouterr()
    assert "pip install followthrough[plot]" in said.err and "| springs |" in said.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["benchmark.json", "benchmark.md"]


def test_emulators_are_measured_with_their_weights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.npz"
    EmulatorWeights(random_parameters(0)).save(path)
    assert run("--weights", str(path), "--solvers", "emulator/mine", "--threads", "1", "2", "--json") == 0
    (size,) = json.loads(capsys.readouterr().out)["sizes"]
    results = size["results"]
    assert [(result["name"], result["threads"]) for result in results] == [("emulator/mine", 1), ("emulator/mine", 2)]
    assert results[0]["single_frame"] > 0 and "237,571 parameters" in results[0]["summary"]
    assert "outside the" in results[0]["notes"][0]  # so coarse a mesh is softer than any that was learned
    assert run("--weights", str(path), str(path)) == 2
    assert "found two files mine.npz" in capsys.readouterr().err
    path.write_bytes(b"")
    assert run("--weights", str(path)) == 2
    assert f"error: {path}: " in capsys.readouterr().err


def test_the_emulator_that_comes_along_is_measured_with_every_number_of_corrections(
    tmp_path: Path, scene: Scene, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(emulator_weights, "SHIPPED", tmp_path / "emulator.npz")
    names = [f"emulator/{corrections}" for corrections in range(4)]
    assert run("--solvers", "skinning", "emulator") == 0
    printed = capsys.readouterr().out
    assert all(f"{name} was left out: this version brings no weights" in printed for name in names)
    EmulatorWeights(random_parameters(0)).save(emulator_weights.SHIPPED)
    results = by_name(measure(scene, select(["emulator"]), [1]).results)
    assert list(results) == names
    errors = [results[name].single_frame for name in names]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 0.5 * errors[0]
    assert [results[name].work.get("Newton", 0) for name in names] == pytest.approx([0, 1, 2, 3], abs=0.5)


def test_what_is_left_out_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main("benchmark --quiet --sizes 200 300 --frames 9 --seconds 1e-9 --solvers skinning".split()) == 0
    printed = capsys.readouterr().out
    assert "Left out: 200 vertices, as the 1e-09 seconds were spent." in printed
    assert cli.main("benchmark --quiet --sizes 300 --frames 3000 --seconds 1 --solvers skinning".split()) == 0
    assert "of 3000 frames at" in capsys.readouterr().out


def test_an_interrupt_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*anything: Any) -> None:
        raise KeyboardInterrupt

    usual = _core.threads()
    monkeypatch.setattr(measurement._Lane, "judge", interrupted)
    assert run("--threads", "1", "-o", str(tmp_path / "new")) == 130
    assert capsys.readouterr().out == ""
    assert not list(tmp_path.iterdir())
    assert _core.threads() == usual


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--sizes", "100"], "--sizes: found 100, expected 200 or more"),
        (["--frames", "0"], "--frames: found 0"),
        (["--threads", "0"], "--threads: found 0"),
        (["--seconds", "nan"], "--seconds: found nan"),
        (["--solvers", "magic"], "solvers: found magic"),
        (["-o", "/no/such/folder"], "is no folder"),
    ],
)
def test_bad_options_are_named(words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*words) == 2
    said = capsys.readouterr()
    assert complaint in said.err and said.out == ""
