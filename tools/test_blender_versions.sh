#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Runs tests/blender in a real bpy of every Blender that is supported. BLENDER_VERSIONS="4.2 5.2" picks some.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/.."
declare -A python_of=([4.2]=3.11 [4.5]=3.11 [5.0]=3.11 [5.2]=3.13)
failed=()
for blender in ${BLENDER_VERSIONS:-4.2 4.5 5.0 5.2}; do
  venv=.venv-bpy$blender
  interpreter=$(bash "$here/find_python.sh" "${python_of[$blender]}")
  [ -x "$venv/bin/python" ] || "$interpreter" -m venv "$venv"
  "$venv/bin/python" "$here/requirements.py" demo test > "$venv/requirements.txt"
  sed -i "s/^bpy.*/bpy==$blender.*/" "$venv/requirements.txt"
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$venv/requirements.txt"
  bash "$here/blender_libraries.sh" "$venv/bin/python"
  wheel=$("$venv/bin/python" "$here/built_wheel.py")
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$wheel"
  echo "== Blender $blender (Python ${python_of[$blender]})"
  bash "$here/blender_tests.sh" "$venv/bin/python" || failed+=("$blender")
done
[ ${#failed[@]} -eq 0 ] || { echo "The Blender tests failed in: ${failed[*]}" >&2; exit 1; }
