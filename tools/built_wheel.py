# SPDX-License-Identifier: GPL-3.0-or-later
"""Print a wheel of this checkout for an interpreter: built_wheel.py [PYTHON]. It is built only where none is as new as the sources, so that
every virtual environment of one Python version, and the extension, install the same one.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: What a wheel is made of.
SOURCES = (
    "cpp/include",
    "cpp/src",
    "cpp/bindings",
    "cmake",
    "python",
    "CMakeLists.txt",
    "pyproject.toml",
    "README.md",
    "LICENSE",
)
#: Says which Python and which build tools an interpreter has.
_PROBE = """
import importlib.util, sys, sysconfig
found = all(importlib.util.find_spec(name) for name in ("scikit_build_core", "pybind11", "cmeel"))
print("cp%d%d" % sys.version_info[:2], sysconfig.get_platform().replace("-", "_").replace(".", "_"), int(found))
"""


def built_wheel(interpreter: str) -> Path:
    """The wheel for an interpreter, built if need be.

    Raises
    ------
    subprocess.CalledProcessError
        Where it cannot be built; `stdout` and `stderr` say why.
    """
    probe = subprocess.run([interpreter, "-c", _PROBE], capture_output=True, text=True, check=True)
    tag, platform, has_tools = probe.stdout.split()
    folder = ROOT / "build" / "wheels" / f"{tag}-{platform}"
    newest = max(path.stat().st_mtime for path in _sources())
    for wheel in folder.glob("*.whl"):
        if wheel.stat().st_mtime >= newest:
            return wheel
    folder.mkdir(parents=True, exist_ok=True)
    begun = time.time()
    # Without isolation the build tools stay where they are, and a second build takes only what has changed.
    isolation = ["--no-build-isolation"] if has_tools == "1" else []
    with tempfile.TemporaryDirectory(dir=folder) as built:
        command = [interpreter, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", *isolation]
        subprocess.run([*command, "--wheel-dir", built, str(ROOT)], capture_output=True, text=True, check=True)
        (made,) = Path(built).glob("*.whl")
        for old in folder.glob("*.whl"):
            old.unlink()
        os.utime(made, (begun, begun))  # what changes while it is built is newer
        return made.rename(folder / made.name)


def _sources() -> Iterator[Path]:
    for name in SOURCES:
        path = ROOT / name
        inside = path.rglob("*") if path.is_dir() else [path]
        yield from (
            file for file in inside if file.is_file() and "__pycache__" not in file.parts and file.suffix != ".so"
        )


if __name__ == "__main__":
    try:
        print(built_wheel(sys.argv[1] if len(sys.argv) > 1 else sys.executable))
    except subprocess.CalledProcessError as error:
        print(f"{error.stdout or ''}{error.stderr or ''}", file=sys.stderr)
        raise SystemExit(f"built_wheel: error: the wheel could not be built ({error.returncode})") from None
