#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Checks the compiler and makes the virtual environment: setup.sh VENV
# PYTHON=/path/to/python chooses the interpreter; otherwise the first of CPython 3.11 and 3.13 found is taken, because Blender's bpy has
# wheels for those, and any newer python3 after them.
set -euo pipefail
venv=${1:?the folder of the virtual environment}
here=$(cd "$(dirname "$0")" && pwd)

command -v c++ >/dev/null || bash "$here/apt_require.sh" g++
if ! printf '#include <span>\nstd::span<int> s;\nint main(){}\n' | c++ -std=c++20 -x c++ -fsyntax-only - 2>/dev/null; then
  echo "setup: found no C++ compiler that does C++20; expected GCC 11, Clang 14 or newer as c++. Install one (Debian: apt install g++)." >&2
  exit 1
fi
bash "$here/apt_require.sh" doctest-dev

python=$(bash "$here/find_python.sh" ${PYTHON:+"$PYTHON"})
version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
echo "Setting up $venv with Python $version"
"$python" -c 'import ensurepip' 2>/dev/null || bash "$here/apt_require.sh" "python$version-venv"
"$python" -c 'import pathlib, sysconfig; raise SystemExit(not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").exists())' ||
  bash "$here/apt_require.sh" "python$version-dev"
[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"

# One list for everybody: the build's requirements, the library's own and the extras, read from pyproject.toml.
extras=(demo tetgen plot test dev)
case $version in
3.11 | 3.13) ;;
*)
  echo "setup: Python $version has no bpy wheel: 'make demo' and the Blender tests need Python 3.11 or 3.13 (PYTHON=... make setup)" >&2
  extras=(plot test dev)
  ;;
esac
"$venv/bin/python" "$here/requirements.py" "${extras[@]}" > "$venv/requirements.txt"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$venv/requirements.txt"
case $version in 3.11 | 3.13) bash "$here/blender_libraries.sh" "$venv/bin/python" ;; esac
