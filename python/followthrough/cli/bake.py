# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough bake`: a character's file in, a .blend out that plays its secondary motion as shape keys.

It needs Blender's Python module (`pip install followthrough[blender]`), or runs inside Blender itself, where the
`followthrough` package can be imported::

    blender --background --python-exit-code 1 --python-expr \
        "import sys; from followthrough.cli import main; sys.exit(main(['bake', 'fox.glb', '-o', 'baked.blend']))"
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from followthrough.cli import solver_options
from followthrough.cli.progress import with_progress
from followthrough.elastic import QUALITIES
from followthrough.settings import (
    SOLVERS,
    EmulatorSettings,
    Settings,
    SimulationSettings,
    SpringSettings,
    VolumeSettings,
    default_solver,
)

if TYPE_CHECKING:
    import bpy

    from followthrough.blender import BakeReport, FrameRange, ObjectReport, ObjectSettings

_NO_BLENDER = (
    "this command needs Blender's Python module: pip install 'followthrough[blender]', or run it inside Blender: "
    "blender --background --python-expr \"from followthrough.cli import main; main(['bake', 'IN.glb', '-o', "
    "'OUT.blend'])\""
)


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    volume = VolumeSettings()
    parser = subparsers.add_parser(
        "bake",
        help="bake a character's secondary motion to shape keys",
        description="Open a character, simulate its secondary motion and write a .blend that plays it as shape keys, "
        "in any Blender. Every skinned mesh of the file is baked unless --object chooses. Vertex groups called "
        "'Followthrough Stiffness', 'Followthrough Mass' and 'Followthrough Pins' are read where the mesh has them; "
        "where it has not, values are suggested from the distance to the bones.",
    )
    parser.add_argument("input", metavar="IN", type=Path, help=".blend, .glb, .gltf or .fbx")
    parser.add_argument(
        "-o", "--output", metavar="OUT.blend", type=Path, required=True, help="where to write the result"
    )
    parser.add_argument(
        "--object", metavar="NAME", action="append", help="mesh object to bake; may be given several times"
    )
    parser.add_argument(
        "--action", metavar="NAME", help="action that the armatures play (default: the one of the file)"
    )
    parser.add_argument(
        "--start", metavar="F", type=int, help="first frame (default: the action's where one is chosen or imported)"
    )
    parser.add_argument("--end", metavar="F", type=int, help="last frame (default: as for --start)")
    parser.add_argument(
        "--preroll", metavar="N", type=int, default=0, help="frames that are simulated before the first one"
    )
    parser.add_argument(
        "--cycles",
        metavar="N",
        type=int,
        default=0,
        help="the action is a loop: simulate it N times before it is baked",
    )
    parser.add_argument(
        "--cells",
        metavar="N",
        type=int,
        default=volume.cells,
        help="cells along the longest side (default %(default)s)",
    )
    parser.add_argument(
        "--no-split-parts", action="store_true", help="glue parts of the body that come near each other"
    )
    parser.add_argument(
        "--method", choices=("voxel", "tetgen"), default=volume.method, help="kind of volume (default %(default)s)"
    )
    parser.add_argument(
        "--solver",
        metavar="NAME",
        default=default_solver(),
        help=f"dynamics: {', '.join(SOLVERS[:-1])} (a network that has learned simulated flesh), or {SOLVERS[-1]} "
        "(simulated flesh, finite elements) (default %(default)s)",
    )
    _add_solver_arguments(parser)
    parser.add_argument(
        "--pin-groups",
        metavar="NAME[:STRENGTH]",
        nargs="+",
        help="vertex groups that pin (default: 'Followthrough Pins' where it is there)",
    )
    parser.add_argument("--stiffness-group", metavar="NAME", help="vertex group of painted stiffness")
    parser.add_argument("--mass-group", metavar="NAME", help="vertex group of painted mass")
    parser.add_argument(
        "--output-kind",
        choices=("keys", "absolute", "pc2"),
        default="keys",
        help="relative shape keys, absolute ones in a row, or a point cache (.pc2) beside OUT and a Mesh Cache modifier, "
        "also for linked meshes (default %(default)s)",
    )
    parser.add_argument(
        "--no-resume",
        action="store_true",
        help="begin anew even where an interrupted bake of the same left frames beside OUT",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def _add_solver_arguments(parser: argparse.ArgumentParser) -> None:
    springs, flesh = SpringSettings(), SimulationSettings()
    parser.add_argument(
        "--damping-ratio",
        metavar="Z",
        type=float,
        help=f"share of critical damping (default {springs.damping_ratio:g}; of emulator and implicit-euler {flesh.damping_ratio:g}, "
        "beside what backward Euler damps by itself)",
    )
    parser.add_argument(
        "--gravity",
        metavar="G",
        type=float,
        help=f"downwards, m/s² for a character 1 m long (default {flesh.gravity:g})",
    )
    solver_options.add_amplitude_argument(parser)
    group = parser.add_argument_group("springs")
    group.add_argument(
        "--stiffness",
        metavar="KS or LOW:HIGH",
        type=_range,
        help="spring stiffness, 1/s²: one for all, or those of paint 0 and 1 "
        f"(default {springs.stiffness_range[0]:g}:{springs.stiffness_range[1]:g})",
    )
    group.add_argument("--damping", metavar="KD", type=float, help="spring damping, 1/s, the same everywhere")
    group.add_argument(
        "--no-learned",
        dest="use_learned",
        action="store_const",
        const=False,
        help="painted springs even where the file has some that were learned from a simulation",
    )
    group = parser.add_argument_group("emulator and implicit-euler")
    group.add_argument(
        "--youngs-modulus",
        metavar="E or LOW:HIGH",
        type=_range,
        help="of a character 1 m long, Pa: one for all, or those of paint 0 and 1; other sizes by their square "
        f"(default {flesh.youngs_modulus_range[0]:g}:{flesh.youngs_modulus_range[1]:g})",
    )
    group.add_argument(
        "--density",
        metavar="RHO or LOW:HIGH",
        type=_range,
        help="kg/m³: one for all, or those of paint 0 and 1 "
        f"(default {flesh.density_range[0]:g}:{flesh.density_range[1]:g})",
    )
    group = parser.add_argument_group("emulator")
    solver_options.add_weights_arguments(group)
    group = parser.add_argument_group("implicit-euler")
    group.add_argument("--quality", choices=QUALITIES, help=f"how exact a frame is (default {flesh.quality})")


#: Solver -> the options that it has.
_OPTIONS = {
    "springs": ("stiffness", "damping", "use_learned"),
    "emulator": ("youngs_modulus", "density", "weights", "corrections"),
    "implicit-euler": ("youngs_modulus", "density", "quality"),
}


def _motion_settings(args: argparse.Namespace) -> Settings:
    solver_options.check_owners(args, _OPTIONS)
    if args.damping is not None and args.damping_ratio is not None:
        raise ValueError("--damping: found together with --damping-ratio, expected one of them")
    springs = {
        "stiffness_range": args.stiffness,
        "damping": args.damping,
        "gravity": args.gravity,
        "use_learned": args.use_learned,
        # Learned springs are as they were learned, unless something is asked for that they can be compared with.
        "scale_learned": any(value is not None for value in (args.stiffness, args.damping, args.damping_ratio)),
    }
    flesh = {
        "youngs_modulus_range": args.youngs_modulus,
        "density_range": args.density,
        "gravity": args.gravity,
        "quality": args.quality,
    }
    (springs if args.solver == "springs" else flesh)["damping_ratio"] = args.damping_ratio
    return Settings(
        volume=VolumeSettings(cells=args.cells, split_parts=not args.no_split_parts, method=args.method),
        solver=args.solver,
        springs=SpringSettings(**_given(springs)),
        simulation=SimulationSettings(**_given(flesh)),
        emulator=EmulatorSettings(weights=args.weights, corrections=args.corrections or 0),
        amplitude=args.amplitude,
    )


def _given(options: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def run(args: argparse.Namespace) -> int:
    """Do it."""
    motion = _motion_settings(args)
    try:
        import bpy
    except ImportError as problem:
        raise ValueError(_NO_BLENDER) from problem
    from followthrough import blender
    from followthrough.blender import actions, files, point_cache
    from followthrough.blender.scene import skeleton_of

    groups = blender.PaintGroups(
        stiffness=args.stiffness_group,
        mass=args.mass_group,
        pins=None if args.pin_groups is None else tuple(_pin_group(text) for text in args.pin_groups),
    )
    settings = blender.ObjectSettings(motion=motion, groups=groups, output=args.output_kind)
    files.require_output(args.output)
    imported = files.open_file(args.input)
    if bpy.app.autoexec_fail:
        print(
            "followthrough: the file has Python drivers or scripts that Blender's preferences do not let run "
            f"({bpy.app.autoexec_fail_message}); what they move is baked without them",
            file=sys.stderr,
        )
    chosen = _choose(args.object)
    frame_range: tuple[int, int] | None = None
    if args.action is not None or imported:
        meshes = [bpy.data.objects[name] for names in chosen.values() for name in names]
        armatures = {skeleton.name: skeleton for skeleton in map(skeleton_of, meshes) if skeleton is not None}
        if args.action is not None:
            frame_range = actions.play_action(armatures.values(), args.action)
        else:
            frame_range = actions.played_range(armatures.values())
    start, end = actions.scene_frames(frame_range, bpy.data.scenes[next(iter(chosen))]) if frame_range else (None, None)
    frames = blender.FrameRange(
        start=start if args.start is None else args.start,
        end=end if args.end is None else args.end,
        preroll=args.preroll,
        cycles=args.cycles,
    )
    for scene_name, names in chosen.items():
        scene = bpy.data.scenes[scene_name]
        if args.no_resume:
            blender.BakeCache(blender.cache_folder(args.output), scene_name, names).remove()
        report = _bake(scene, dict.fromkeys(names, settings), frames, args)
        if imported:
            scene.frame_start, scene.frame_end = report.start, report.end
            scene.frame_set(report.start)
        _print_report(report)
    files.save_file(args.output, pack=imported)
    if args.output_kind == "pc2":
        for name in (name for names in chosen.values() for name in names):
            print(f"{point_cache.path_of(args.output, name)}: written")
    print(f"{args.output}: written")
    return 0


def _choose(wanted: list[str] | None) -> dict[str, list[str]]:
    """Names of the objects to bake, by the name of their scene."""
    import bpy

    from followthrough import blender

    chosen: dict[str, list[str]] = {}
    left = None if wanted is None else list(dict.fromkeys(wanted))
    taken: set[str] = set()
    scenes = [bpy.context.scene, *(scene for scene in bpy.data.scenes if scene != bpy.context.scene)]
    for scene in scenes:
        if left is None:
            view_layer = bpy.context.view_layer if scene == bpy.context.scene else scene.view_layers[0]
            meshes = blender.skinned_meshes(scene)
            hidden = [obj.name for obj in meshes if not obj.visible_get(view_layer=view_layer)]
            if hidden:
                print(f"followthrough: passed over what is hidden: {', '.join(map(repr, hidden))}", file=sys.stderr)
            names = [obj.name for obj in meshes if obj.name not in taken and obj.name not in hidden]
        else:
            names = [name for name in left if name in scene.objects and name not in taken]
        taken.update(names)
        if names:
            chosen[scene.name] = names
    missing = [name for name in left or () if name not in taken]
    if missing:
        there = ", ".join(repr(obj.name) for obj in bpy.data.objects if obj.type == "MESH") or "none"
        raise ValueError(f"--object: found no object {missing[0]!r} in the file, expected one of its meshes ({there})")
    if not chosen:
        _explain_nothing_to_bake()
    return chosen


def _explain_nothing_to_bake() -> None:
    import bpy

    from followthrough import blender
    from followthrough.blender.scene import skeleton_of

    meshes = [obj for obj in bpy.data.objects if obj.type == "MESH"]
    if not meshes:
        raise ValueError("the file has no mesh: there is nothing to bake")
    if any(blender.skinned_meshes(scene) for scene in bpy.data.scenes):
        raise ValueError("every mesh that an armature moves is hidden: show one, or leave only those that are wanted")
    outside = [obj.name for obj in meshes if skeleton_of(obj) is not None and not obj.users_scene]
    if outside:
        raise ValueError(
            f"{', '.join(map(repr, outside))} is in no scene (its collection may be instanced): link the collection to the scene"
        )
    reasons = filter(None, map(blender.why_not_bakeable, meshes))
    raise ValueError(next(reasons, "no mesh of the file is moved by an armature: choose one with --object"))


def _bake(
    scene: bpy.types.Scene, objects: dict[str, ObjectSettings], frames: FrameRange, args: argparse.Namespace
) -> BakeReport:
    from followthrough import blender

    cache = blender.cache_folder(args.output)
    bake = blender.Bake(scene, objects, frames, cache, blend=args.output)
    for caution in bake.cautions:
        print(f"followthrough: warning: {caution} (--solver implicit-euler)", file=sys.stderr)
    recovery = bake.recovery
    try:
        for _ in with_progress(_Steps(bake), "bake", quiet=args.quiet):
            pass
    except KeyboardInterrupt:
        if recovery.saved_frame is not None:
            print(
                f"followthrough: the same command goes on from frame {recovery.saved_frame} ({cache})", file=sys.stderr
            )
        raise
    if recovery.resumed_from is not None:
        print(f"followthrough: went on from frame {recovery.resumed_from}", file=sys.stderr)
    if recovery.has_begun_anew:
        print("followthrough: what an earlier bake left was of something else: begun anew", file=sys.stderr)
    if recovery.problem is not None:
        print(f"followthrough: warning: no cache could be written ({recovery.problem})", file=sys.stderr)
    return bake.finish()


class _Steps:
    """The bake's frames with their number, which a progress bar asks for."""

    def __init__(self, bake: Any) -> None:
        self._bake = bake

    def __len__(self) -> int:
        return int(self._bake.total)

    def __iter__(self) -> Any:
        done = 0
        for progress in self._bake.run(patience=0.1):  # so that an interrupt is heard within a long frame
            if progress.done > done:
                done = progress.done
                yield progress


def _print_report(report: BakeReport) -> None:
    for entry in report.objects:
        print(
            f"{entry.name}: frames {report.start} to {report.end}, {entry.vertices} vertices, {entry.tets} tets, "
            f"largest displacement {entry.largest_displacement:.4g} m, largest residual {entry.largest_residual:.2g} m"
            f"{_cost(entry)}"
        )
        for warning in replace(entry, caution="").warnings:  # which was said at the start
            print(f"followthrough: warning: {warning}", file=sys.stderr)
    print(f"baked in {report.seconds:.1f} s")


def _cost(entry: ObjectReport) -> str:
    """What it took where bones do not tell everything."""
    if not entry.evaluations_per_frame:
        return ""
    return f", searched with {entry.evaluations_per_frame:.1f} evaluations a frame"


def _range(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    try:
        return float(low), float(high or low)
    except ValueError as problem:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected a number, or two as LOW:HIGH") from problem


def _pin_group(text: str) -> Any:
    """A group's name, and its strength behind a colon; a colon without a number belongs to the name."""
    from followthrough.blender import PinGroup

    name, colon, strength = text.rpartition(":")
    if colon:
        try:
            return PinGroup(name, float(strength))
        except ValueError:
            if _is_number(strength):
                raise
    return PinGroup(text)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
