#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Runs tests/blender with the Python that it is given. Folders get a process of their own each: a Blender that has opened
# hundreds of files and registered the add-on dozens of times in one process, as nobody's does, can crash (4.2 did).
set -euo pipefail
cd "$(dirname "$0")/.."
failed=0
for part in tests/blender/addon tests/blender/bake "tests/blender/test_*.py"; do
  "$1" -m pytest $part || failed=1  # unquoted: a pattern
done
exit $failed
