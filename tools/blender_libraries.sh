#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Makes sure that the system libraries are there that a Python's bpy links to: blender_libraries.sh PYTHON
set -euo pipefail
python=${1:?a Python with bpy}
"$python" -c 'import bpy' 2>/dev/null && exit 0
bash "$(dirname "$0")/apt_require.sh" libx11-6 libxi6 libxxf86vm1 libxfixes3 libxrender1 libxkbcommon0 libsm6 libice6 libgl1 libegl1 libgomp1
"$python" -c 'import bpy' && exit 0
echo "blender_libraries: bpy does not load in $python; the line above names the library that is missing" >&2
exit 1
