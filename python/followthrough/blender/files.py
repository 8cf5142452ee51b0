# SPDX-License-Identifier: GPL-3.0-or-later
"""Opening characters from files, and saving without leaving half a file behind."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy

#: What `open_file` takes, by the ending of the name.
IMPORTS = (".glb", ".gltf", ".fbx")

# Blender files start with their name, or with the mark of zstd or gzip where they are compressed.
_BLEND_STARTS = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")


def open_file(path: Path) -> bool:
    """Open a .blend, or import a .glb, .gltf or .fbx into an empty file.

    Returns
    -------
    Whether it was imported.

    Raises
    ------
    OSError
        Where the file cannot be read.
    ValueError
        Where it is no file of its kind, or of a newer Blender.
    """
    with path.open("rb") as file:
        start = file.read(8)
    ending = path.suffix.lower()
    if ending != ".blend" and ending not in IMPORTS:
        raise ValueError(f"{path}: found a file of kind {ending or '(none)'!r}, expected .blend, .glb, .gltf or .fbx")
    gc.collect()  # what cycles still hold of the file that goes: Blender 4.2 can crash where it is freed later
    try:
        with _quiet():
            if ending == ".blend":
                if not start.startswith(_BLEND_STARTS):
                    raise ValueError("this is no Blender file")
                bpy.ops.wm.open_mainfile(filepath=str(path))
            else:
                bpy.ops.wm.read_factory_settings(use_empty=True)
                _import(path, ending)
    except Exception as problem:  # importers raise whatever a broken file leads them to
        reason = str(problem).strip().splitlines()
        raise ValueError(f"{path}: cannot be read ({reason[0] if reason else type(problem).__name__})") from problem
    if ending != ".blend" and not bpy.data.objects:
        raise ValueError(f"{path}: holds no objects")
    return ending != ".blend"


def require_output(path: Path) -> None:
    """Check that a .blend can be written there, before any work is done.

    Raises
    ------
    ValueError, OSError
        Where it cannot.
    """
    if path.suffix.lower() != ".blend":
        raise ValueError(f"{path}: found an output of kind {path.suffix or '(none)'!r}, expected .blend")
    if path.is_dir():
        raise ValueError(f"{path}: is a folder, expected the name of a file")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise ValueError(f"{folder}: this folder is not there; make it first")
    with tempfile.NamedTemporaryFile(dir=folder, prefix=f".{path.stem}-", suffix=".tmp"):
        pass


def save_file(path: Path, pack: bool) -> None:
    """Save the open file there, all or nothing.

    Parameters
    ----------
    path
        A .blend.
    pack
        Put images and other outside files into it.
    """
    if pack:
        with contextlib.suppress(
            RuntimeError
        ):  # a texture that is not there cannot be packed, and was not there before
            bpy.ops.file.pack_all()
    path = path.absolute()
    unfinished = path.with_name(f".{path.stem}-{os.getpid()}.blend")
    versions = bpy.context.preferences.filepaths.save_version
    try:
        bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside it
        with _quiet():
            bpy.ops.wm.save_as_mainfile(filepath=str(unfinished), check_existing=False, copy=True)
        unfinished.replace(path)
    except RuntimeError as problem:
        raise OSError(f"{path}: cannot be written ({str(problem).strip()})") from problem
    finally:
        bpy.context.preferences.filepaths.save_version = versions
        unfinished.unlink(missing_ok=True)


def _import(path: Path, ending: str) -> None:
    if ending == ".fbx":
        # The importer written in Python is the older one; some day only the other is left.
        if hasattr(bpy.types, "IMPORT_SCENE_OT_fbx"):
            result = bpy.ops.import_scene.fbx(filepath=str(path))
        else:
            result = bpy.ops.wm.fbx_import(filepath=str(path))
    else:
        result = bpy.ops.import_scene.gltf(filepath=str(path))
    if "FINISHED" not in result:
        raise ValueError("the importer gave up")


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Blender and its importers print off the standard output, which belongs to the command's result."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        with Path(os.devnull).open("wb") as nothing, contextlib.redirect_stdout(io.StringIO()):
            os.dup2(nothing.fileno(), 1)
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
