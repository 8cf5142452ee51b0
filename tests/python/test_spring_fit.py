# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs that learn: constants come back from motion, through the library and through the command line."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough import mesh
from followthrough.cli import main
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.sequences import Sequence
from followthrough.simulation import load_constants, simulate
from followthrough.spring_fit import (
    FitSettings,
    FitStatus,
    Training,
    fit_springs,
    share_stiff_constants,
    spring_loss,
)
from followthrough.springs import Springs

Array = NDArray[np.float64]

DT = 1 / 24
CUBE_TETS = [(0, 4, 2, 1), (4, 2, 1, 5), (2, 1, 5, 3), (4, 6, 2, 5), (6, 5, 7, 3), (6, 2, 5, 3)]


def waves(frames: int, count: int, seed: int) -> Array:
    """Motion (frames, count, 3) of several frequencies."""
    random = np.random.default_rng(seed)
    sizes, rates, phases = (
        random.normal(0, 0.1, (4, count, 3)),
        random.uniform(1, 13, (4, count, 3)),
        random.random((4, count, 3)),
    )
    time = DT * np.arange(frames)[:, None, None]
    return sum(size * np.sin(rate * time + 6 * phase) for size, rate, phase in zip(sizes, rates, phases, strict=True))


def sequence_of(reference: Array, dynamic: Array | None = None, constrained: Array | None = None) -> Sequence:
    """A sequence without tets."""
    count = reference.shape[1]
    return Sequence(
        rest_positions=reference[0],
        tets=np.zeros((0, 4), dtype=np.int32),
        constrained=np.zeros(count, dtype=bool) if constrained is None else constrained,
        youngs_modulus=np.full(count, 1e5),
        dt=DT,
        reference=reference,
        dynamic=dynamic,
    )


def run_springs(reference: Array, stiffness: Array, damping: Array) -> Array:
    result = simulate(sequence_of(reference), Springs(stiffness, damping, DT)).dynamic
    assert result is not None
    return result


def constants(count: int, seed: int) -> tuple[Array, Array]:
    """In every regime of damping."""
    random = np.random.default_rng(seed)
    stiffness = 10 ** random.uniform(1, 4, count)
    ratio = 10 ** random.uniform(-1.7, 1.3, count)
    ratio[::5] = 1.0
    return stiffness, 2 * ratio * np.sqrt(stiffness)


def off(found: Array, true: Array) -> float:
    return float(np.abs(found / true - 1).max())


@pytest.fixture(scope="module")
def truth() -> tuple[Training, Array, Array]:
    stiffness, damping = constants(100, 1)
    reference = waves(100, 100, 2)
    return Training(reference, run_springs(reference, stiffness, damping), DT), stiffness, damping


@pytest.fixture
def bar(tmp_path: Path) -> Callable[[str, int], Path]:
    """Writes a shaken bar of two cubes, held at one end, simulated as flesh."""

    def write(name: str, seed: int) -> Path:
        rest = np.array([(x, y, z) for x in range(3) for y in range(2) for z in range(2)], dtype=float) * 0.2
        push = 0.3 * waves(60, 1, seed) * [0, 1, 1]  # across: along itself the bar is stiffer than any spring of its
        sequence = Sequence(
            rest_positions=rest,
            tets=np.concatenate([np.array(CUBE_TETS), np.array(CUBE_TETS) + 4]).astype(np.int32),
            constrained=rest[:, 0] < 0.1,
            youngs_modulus=np.full(12, 2e5),
            dt=0.03,
            reference=rest + push - push[0],
        )
        solver = ImplicitEuler(ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt)
        simulate(sequence, solver).save(tmp_path / name)
        return tmp_path / name

    return write


def test_true_constants_come_back_in_every_regime(truth: tuple[Training, Array, Array]) -> None:
    motion, stiffness, damping = truth
    fit = fit_springs([motion])
    assert off(fit.stiffness, stiffness) < 0.01
    assert off(fit.damping, damping) < 0.01
    assert (fit.status == FitStatus.FITTED).all()
    assert fit.rmse < 0.01 * fit.reference_rmse
    assert np.array_equal(fit.overdamped, fit.damping**2 > 4 * fit.stiffness)


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_corrupted_frames_are_left_out_where_asked(truth: tuple[Training, Array, Array], size: float) -> None:
    motion, stiffness, damping = truth
    random = np.random.default_rng(3)
    dynamic = motion.dynamic.copy()
    lag = np.sqrt(((motion.dynamic - motion.reference) ** 2).mean(axis=(0, 2)))
    for vertex in range(100):
        frames = random.choice(np.arange(1, 100), 9, replace=False)
        kick = random.normal(0, 1, (9, 3))
        kick /= np.linalg.norm(kick, axis=1, keepdims=True)  # some small ones would hide among the good frames
        dynamic[frames, vertex] += size * lag[vertex] * kick * np.sqrt(3)
    corrupted = Training(motion.reference, dynamic, DT)
    robust = fit_springs([corrupted], FitSettings(dropped_share=0.1))
    plain = fit_springs([corrupted])
    assert max(off(robust.stiffness, stiffness), off(robust.damping, damping)) < 0.05
    assert np.median(np.abs(np.log(plain.damping / damping))) > 5 * np.median(np.abs(np.log(robust.damping / damping)))
    assert max(off(plain.stiffness, stiffness), off(plain.damping, damping)) > 0.2


def test_gradients_agree_with_differences(truth: tuple[Training, Array, Array]) -> None:
    motion, _, _ = truth
    stiffness, damping = constants(100, 9)
    _, by_stiffness, by_damping = spring_loss([motion], stiffness, damping)
    step = 1e-5
    ups, downs = (spring_loss([motion], stiffness * np.exp(sign * step), damping)[0] for sign in (1, -1))
    assert np.allclose((ups - downs) / (2 * step), by_stiffness, rtol=1e-5, atol=1e-7)
    ups, downs = (spring_loss([motion], stiffness, damping * np.exp(sign * step))[0] for sign in (1, -1))
    assert np.allclose((ups - downs) / (2 * step), by_damping, rtol=1e-5, atol=1e-7)


def test_the_file_is_what_simulate_reads(truth: tuple[Training, Array, Array], tmp_path: Path) -> None:
    motion, _, _ = truth
    sequence_of(motion.reference, motion.dynamic).save(tmp_path / "seq.npz")
    springs, out = tmp_path / "springs.npz", tmp_path / "out.npz"
    assert main(["fit-springs", str(tmp_path / "seq.npz"), "-o", str(springs), "--quiet"]) == 0
    fit = fit_springs([motion])
    ks, kd = load_constants(springs, 100)
    assert np.array_equal(ks, fit.stiffness)
    assert np.array_equal(kd, fit.damping)
    assert main(["simulate", str(tmp_path / "seq.npz"), "--springs", str(springs), "-o", str(out), "--quiet"]) == 0
    dynamic = Sequence.load(out).dynamic
    assert dynamic is not None
    assert np.sqrt(((dynamic - motion.dynamic) ** 2).mean()) == pytest.approx(fit.rmse, rel=1e-6)


def test_flesh_is_learned_and_carried_to_another_motion(
    bar: Callable[[str, int], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, other = bar("a.npz", 1), bar("b.npz", 2), bar("c.npz", 3)
    springs, out = tmp_path / "springs.npz", tmp_path / "out.npz"
    arguments = ["fit-springs", str(first), str(second), "--frames", "50", "-o", str(springs), "--quiet", "--json"]
    assert main(arguments) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["frames"] == 2 * 49
    assert report["fitted"] == 8
    assert report["constrained"] == 4
    assert report["rmse"] < 0.75 * report["rmse_before"]
    assert main(["simulate", str(other), "--springs", str(springs), "-o", str(out), "--quiet"]) == 0
    true, found = Sequence.load(other), Sequence.load(out)
    assert true.dynamic is not None and found.dynamic is not None
    assert np.linalg.norm(found.dynamic - true.dynamic) < 0.85 * np.linalg.norm(true.reference - true.dynamic)


def test_springs_over_equilibria(
    bar: Callable[[str, int], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence, springs, out = bar("a.npz", 4), tmp_path / "springs.npz", tmp_path / "out.npz"
    gravity = ["--over", "quasistatic", "--gravity", "0", "0", "-1"]
    assert main(["fit-springs", str(sequence), "-o", str(springs), "--quiet", "--json", *gravity]) == 0
    report = json.loads(capsys.readouterr().out)
    assert main(["simulate", str(sequence), "--springs", str(springs), "-o", str(out), "--quiet", *gravity]) == 0
    true, found = Sequence.load(sequence), Sequence.load(out)
    assert true.dynamic is not None and found.dynamic is not None
    free = ~true.constrained
    rmse = np.sqrt(((found.dynamic - true.dynamic)[1:, free] ** 2).mean())
    assert rmse == pytest.approx(report["rmse"], rel=1e-3)


def test_springs_on_the_surface(bar: Callable[[str, int], Path], tmp_path: Path) -> None:
    path = bar("a.npz", 5)
    sequence = Sequence.load(path)
    points = np.array([[0.05, 0.1, 0.1], [0.3, 0.2, 0.1], [0.4, 0.1, 0.0]])
    carriers, weights = mesh.embed(points, sequence.rest_positions, sequence.tets)
    np.savez(tmp_path / "volume.npz", tets=sequence.tets, embedding_tets=carriers, embedding_weights=weights)
    springs, out = tmp_path / "springs.npz", tmp_path / "out.npz"
    on = ["--surface", str(tmp_path / "volume.npz"), "--quiet"]
    assert main(["fit-springs", str(path), "-o", str(springs), *on]) == 0
    assert main(["simulate", str(path), "--springs", str(springs), "-o", str(out), *on]) == 0
    found = Sequence.load(out)
    assert found.dynamic is not None and sequence.dynamic is not None
    assert found.vertex_count == 3
    assert np.allclose(found.rest_positions, points)
    carried = np.array([mesh.interpolate(frame, sequence.tets, carriers, weights) for frame in sequence.dynamic])
    assert np.linalg.norm(found.dynamic - carried) < 0.6 * np.linalg.norm(found.reference - carried)


def test_stiff_vertices_share_constants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    random = np.random.default_rng(6)
    stiffness = np.where(np.arange(60) < 40, 10 ** random.uniform(3.5, 5, 60), 100.0)
    damping = np.where(np.arange(60) < 40, 3.0 * np.sqrt(stiffness), 5.0)
    reference = waves(60, 60, 7)
    motion = Training(reference, run_springs(reference, stiffness, damping), DT)
    fit = fit_springs([motion])
    shared, stiff = share_stiff_constants(fit, [motion])
    assert np.array_equal(stiff, np.arange(60) < 40)
    assert len(np.unique(shared.stiffness[stiff])) == len(np.unique(shared.damping[stiff])) == 1
    assert np.array_equal(shared.stiffness[~stiff], fit.stiffness[~stiff])
    assert fit.rmse < shared.rmse < 0.1 * shared.reference_rmse
    sequence_of(motion.reference, motion.dynamic).save(tmp_path / "seq.npz")
    arguments = ["fit-springs", str(tmp_path / "seq.npz"), "-o", str(tmp_path / "s.npz"), "--share-stiff", "--quiet"]
    assert main([*arguments, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["shared"]
    assert report["vertices"] == 40
    assert report["rmse"] == pytest.approx(shared.rmse)
    assert main(arguments) == 0
    assert "40 stiff, overdamped vertices share" in capsys.readouterr().out


def test_vertices_that_tell_nothing_get_constants_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reference = waves(40, 4, 8)
    reference[:, 0] = 5.0
    dynamic = run_springs(reference, np.full(4, 200.0), np.full(4, 8.0))
    dynamic[:, 1] = reference[:, 1]
    fit = fit_springs([Training(reference, dynamic, DT)])
    assert list(fit.status) == [FitStatus.UNMOVED, FitStatus.RIGID, FitStatus.FITTED, FitStatus.FITTED]
    sequence_of(reference, dynamic).save(tmp_path / "seq.npz")
    assert main(["fit-springs", str(tmp_path / "seq.npz"), "-o", str(tmp_path / "s.npz"), "--quiet"]) == 0
    told = capsys.readouterr().err
    assert "1 vertices never leave their reference" in told
    assert "1 vertices are never accelerated" in told


def test_one_seed_gives_one_answer_whatever_the_threads(truth: tuple[Training, Array, Array]) -> None:
    motion, _, _ = truth
    first, again = fit_springs([motion]), fit_springs([motion])
    assert np.array_equal(first.stiffness, again.stiffness)
    part = Training(motion.reference[:, :7], motion.dynamic[:, :7], DT)
    assert np.array_equal(fit_springs([part]).damping, first.damping[:7])


def errors_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 2
    return capsys.readouterr().err


def test_bad_input_is_refused_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reference = waves(10, 3, 1)
    good, out = tmp_path / "good.npz", tmp_path / "springs.npz"
    dynamic = run_springs(reference, np.full(3, 200.0), np.full(3, 8.0))
    sequence_of(reference, dynamic).save(good)

    def errors(path: Path, *more: str) -> str:
        said = errors_of(["fit-springs", str(path), *more, "-o", str(out), "--quiet"], capsys)
        assert not out.exists()
        return said

    sequence_of(reference).save(tmp_path / "bare.npz")
    assert "found no dynamic" in errors(tmp_path / "bare.npz")
    sequence_of(reference[:1], dynamic[:1]).save(tmp_path / "one.npz")
    assert "one frame" in errors(tmp_path / "one.npz")
    still = np.repeat(reference[:1], 5, axis=0)
    sequence_of(still, still).save(tmp_path / "still.npz")
    assert "no vertex whose reference speeds up" in errors(tmp_path / "still.npz")
    sequence_of(reference, dynamic, np.ones(3, dtype=bool)).save(tmp_path / "held.npz")
    assert "no free vertex" in errors(tmp_path / "held.npz")
    arrays = dict(np.load(good))
    arrays["dynamic"][4, 1, 2] = np.nan
    np.savez(tmp_path / "nan.npz", **arrays)
    assert "nan.npz: dynamic: found nan at [4, 1, 2]" in errors(tmp_path / "nan.npz")
    sequence_of(waves(10, 4, 1), waves(10, 4, 2)).save(tmp_path / "four.npz")
    assert "expected the same character" in errors(good, str(tmp_path / "four.npz"))
    assert "--frames" in errors(good, "--frames", "1")
    assert "at most the 10" in errors(good, "--frames", "11")
    assert "--robust" in errors(good, "--robust", "0.95")
    assert "regularization" in errors(good, "--regularization", "-1")
    assert "--quality: found without --over" in errors(good, "--quality", "fine")
    assert "its folder" in errors_of(["fit-springs", str(good), "-o", str(tmp_path / "no" / "s.npz")], capsys)


def test_trainings_are_checked() -> None:
    frames = waves(5, 2, 1)
    with pytest.raises(ValueError, match="reference: found shape"):
        Training(frames[:, 0], frames, DT)
    with pytest.raises(ValueError, match="expected one or more"):
        fit_springs([])
    with pytest.raises(ValueError, match="dynamic"):
        fit_springs([Training(frames, frames[:, :1], DT)])
    with pytest.raises(ValueError, match="skipped"):
        fit_springs([Training(frames, frames, DT)], skipped=[True])
    broken = frames.copy()
    broken[3, 1, 0] = np.inf
    with pytest.raises(ValueError, match="frame 3, vertex 1"):
        fit_springs([Training(frames, broken, DT)])
