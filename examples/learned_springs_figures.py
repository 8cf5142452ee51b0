# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs that learn, on the demo creature: figures 3, 7 and 8 of [ZS], as docs/learned-springs.md shows them.

    python examples/learned_springs_figures.py --output docs/images [--save-sequence bumble.npz]

Simulates 96 frames of the creature's walk and jump as flesh, fits springs to them, and draws what they do. Needs Blender's Python
module and matplotlib (pip install 'followthrough[blender,plot]'). A few minutes on two cores.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import demo_character
from followthrough.blender import read_paint, read_surface
from followthrough.blender.rig_reading import make_reader
from followthrough.blender.scene import require_bakeable
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.flesh import loose_vertices
from followthrough.quasistatic import Quasistatic
from followthrough.sequences import Sequence
from followthrough.settings import SimulationSettings, VolumeSettings
from followthrough.simulation import simulate
from followthrough.spring_fit import FitSettings, SpringFit, Training, fit_springs
from followthrough.spring_heat_map import write_heat_map
from followthrough.springs import Springs
from followthrough.surface_springs import on_surface
from followthrough.volume import Volume, build_volume

FRAMES = 96
#: Where the truth is corrupted for figure 7, as the paper's collisions did it, and by how much of the vertex's own motion.
CORRUPTED = range(31, 35)
CORRUPTION = 2.5
CELLS = 25

Frames = NDArray[np.float64]


@dataclass
class Show:
    """The creature's frames."""

    volume: Volume
    poses: list[object]
    pelvis: NDArray[np.float64]
    dt: float


def read_show() -> Show:
    """Build the creature, and read its poses."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    character = demo_character.build(vertices=4000)
    demo_character.show(character)
    scene, name = bpy.context.scene, character.mesh.name
    scene.frame_set(1)
    surface = read_surface(character.mesh)
    volume = build_volume(surface, read_paint(character.mesh, surface), VolumeSettings(cells=CELLS))
    reader = make_reader(bpy.data.objects[name], require_bakeable(bpy.data.objects[name]), surface)
    poses, pelvis = [], []
    root = next(bone.name for bone in character.armature.pose.bones if bone.parent is None)
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
        poses.append(reader.read(bpy.context.view_layer))
        pelvis.append(np.array(character.armature.matrix_world @ character.armature.pose.bones[root].head))
    return Show(volume, poses, np.array(pelvis), scene.render.fps_base / scene.render.fps)


def simulated(show: Show) -> Sequence:
    """The creature's volume as flesh, with its painted stiffness, as a sequence."""
    volume, settings = show.volume, SimulationSettings()
    low, high = settings.youngs_modulus_range
    light, heavy = settings.density_range
    sequence = Sequence(
        rest_positions=volume.tet_mesh.vertices,
        tets=volume.tet_mesh.tets,
        constrained=volume.pinned | loose_vertices(volume),
        youngs_modulus=low ** (1 - volume.stiffness) * high**volume.stiffness * volume.surface.size**2,
        density=light ** (1 - volume.mass) * heavy**volume.mass,
        dt=show.dt,
        reference=np.array([volume.reference(pose) for pose in show.poses]),
    )
    solver = ImplicitEuler(ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt, quality="fine")
    return simulate(sequence, solver)


def at_rest(sequence: Sequence) -> Sequence:
    """The same, hanging on each pose's static equilibrium."""
    layer = Quasistatic(ElasticBody.of_sequence(sequence), sequence.constrained, quality="fine")
    return replace(sequence, reference=np.array([layer.solve(pose) for pose in sequence.reference]))


def springs_on(sequence: Sequence) -> tuple[Frames, SpringFit]:
    """What springs that were learned on a sequence make of it."""
    assert sequence.dynamic is not None
    fit = fit_springs([Training(sequence.reference, sequence.dynamic, sequence.dt)], skipped=sequence.constrained)
    found = simulate(sequence, Springs(fit.stiffness, fit.damping, sequence.dt, sequence.constrained)).dynamic
    assert found is not None
    return found, fit


def length(vectors: Frames) -> Frames:
    """l2 norm (F,) over all vertices of each frame, a vertex."""
    mean: Frames = np.sqrt(np.mean(np.sum(vectors**2, axis=2), axis=1))
    return mean


def figure_3(show: Show, skinned: Sequence, resting: Sequence, path: Path) -> int:
    """How little is left for springs to learn; returns a vertex that moves and that a spring follows well."""
    assert skinned.dynamic is not None
    dynamic = skinned.dynamic
    over, fit = springs_on(resting)
    free = np.flatnonzero(~skinned.constrained)
    vertex = int(np.argmax(np.where(fit.learned, fit.reference_loss - fit.loss, 0.0)))  # springs explain most there
    figure = Figure(figsize=(11, 8), layout="constrained")
    for column, (chosen, title) in enumerate(((free, "all free vertices"), (np.array([vertex]), "one vertex"))):
        curves = [
            (dynamic - show.pelvis[:, None], "position from the pelvis", "C3"),
            (dynamic - skinned.reference, "skinning to dynamics", "C0"),
            (dynamic - resting.reference, "equilibrium to dynamics", "C2"),
            (over - resting.reference, "equilibrium to springs", "C1"),
        ]
        for row, part in enumerate((curves[:2], curves[1:3], curves[2:])):
            panel = figure.add_subplot(3, 2, 2 * row + column + 1)
            for vectors, label, colour in part:
                panel.plot(range(1, FRAMES + 1), length(vectors[:, chosen]), colour, label=label)
            panel.set(ylabel="m", title=title if row == 0 else None, xlabel="frame" if row == 2 else None)
            panel.legend(fontsize="small", loc="upper left")
            panel.grid(True, alpha=0.3)
    figure.savefig(path, dpi=100)
    for name, reference in (("skinning", skinned.reference), ("equilibria", resting.reference)):
        print(f"{name}: {np.sqrt(np.mean((dynamic - reference)[:, free] ** 2)):.5f} m root mean square")
    print(f"springs over equilibria: {np.sqrt(np.mean((dynamic - over)[:, free] ** 2)):.5f} m")
    print(f"springs over skinning: {np.sqrt(np.mean((dynamic - springs_on(skinned)[0])[:, free] ** 2)):.5f} m")
    lively = fit.learned & (fit.reference_loss > np.median(fit.reference_loss[fit.learned]))
    return int(np.argmin(np.where(lively, fit.loss / np.maximum(fit.reference_loss, 1e-300), np.inf)))


def figure_7(sequence: Sequence, vertex: int, path: Path) -> None:
    """Frames that went wrong, learned from and left out."""
    assert sequence.dynamic is not None
    random = np.random.default_rng(7)
    lag = sequence.dynamic[:, vertex] - sequence.reference[:, vertex]
    broken = sequence.dynamic[:, [vertex]].copy()
    kick = CORRUPTION * np.sqrt(np.mean(lag**2))
    for place, frame in enumerate(CORRUPTED):
        broken[frame - 1, 0] += (-1) ** place * kick * (1 + 0.3 * random.standard_normal(3))
    reference = sequence.reference[:, [vertex]]
    training = Training(reference, broken, sequence.dt)
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    panels = figure.subplots(2, 4)
    for row, (settings, title) in enumerate(
        ((FitSettings(), "all frames"), (FitSettings(dropped_share=0.1), "worst 10 % left out"))
    ):
        fit = fit_springs([training], settings)
        one = Sequence(
            rest_positions=reference[0],
            tets=np.zeros((0, 4), dtype=np.int32),
            constrained=np.zeros(1, dtype=bool),
            youngs_modulus=np.ones(1),
            dt=sequence.dt,
            reference=reference,
        )
        found = simulate(one, Springs(fit.stiffness, fit.damping, sequence.dt)).dynamic
        assert found is not None
        for axis in range(3):
            panel = panels[row, axis]
            panel.plot(
                range(1, FRAMES + 1), (broken - reference)[:, 0, axis], "C0", label="simulation, 4 frames corrupted"
            )
            panel.plot(range(1, FRAMES + 1), (found - reference)[:, 0, axis], "C1", label="springs")
            panel.set(title=f"{'XYZ'[axis]}, {title}", ylabel="m from the reference" if axis == 0 else None)
        panels[row, 3].plot(range(1, FRAMES + 1), np.linalg.norm(found - broken, axis=2)[:, 0], "C3")
        panels[row, 3].set(title="distance", ylabel="m")
        sound = np.setdiff1d(np.arange(FRAMES), np.array(CORRUPTED) - 1)
        true = sequence.dynamic[:, [vertex]]
        print(f"{title}: {np.sqrt(np.mean((found - true)[sound] ** 2)):.5f} m on sound frames")
    panels[0, 0].legend(fontsize="small")
    figure.savefig(path, dpi=100)


def figure_8(show: Show, sequence: Sequence, path: Path) -> None:
    """Where springs are stiff, and how they swing, on the skin."""
    tets = show.volume.tet_mesh
    skin = on_surface(sequence, tets.embedding_tets, tets.embedding_weights)
    assert skin.dynamic is not None
    fit = fit_springs([Training(skin.reference, skin.dynamic, skin.dt)], skipped=skin.constrained)
    surface = show.volume.surface
    write_heat_map(path, skin.rest_positions, surface.triangles, fit.stiffness, fit.damping, fit.learned)
    print(
        f"{int(fit.learned.sum())} of {len(fit.status)} skin vertices learned, {int((fit.overdamped & fit.learned).sum())} overdamped; "
        f"error {fit.rmse:.5f} m, without springs {fit.reference_rmse:.5f} m"
    )


def main() -> None:
    """Write the three figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", metavar="FOLDER", type=Path, required=True)
    parser.add_argument("--save-sequence", metavar="SEQ.npz", type=Path, help="also write what was simulated")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    show = read_show()
    print(f"{len(show.volume.tet_mesh.vertices)} vertices of the volume", file=sys.stderr)
    sequence = simulated(show)
    if args.save_sequence is not None:
        sequence.save(args.save_sequence)
    print("simulated", file=sys.stderr)
    resting = at_rest(sequence)
    vertex = figure_3(show, sequence, resting, args.output / "learned_springs_layers.png")
    figure_7(resting, vertex, args.output / "learned_springs_robust.png")
    figure_8(show, sequence, args.output / "learned_springs_heat_map.png")


if __name__ == "__main__":
    main()
