# SPDX-License-Identifier: GPL-3.0-or-later
"""Stop with a message where this Python has no usable bpy."""

import importlib
import sys

try:
    importlib.import_module("bpy")
except ImportError as error:
    found = f"{sys.version_info.major}.{sys.version_info.minor}"
    sys.exit(
        f"This needs Blender's Python module, and Python {found} could not load it ({error}). bpy has wheels for Python "
        "3.11 and 3.13: install one of them and run 'rm -rf .venv && PYTHON=python3.11 make setup'."
    )
