# SPDX-License-Identifier: GPL-3.0-or-later
"""Training of the emulator in PyTorch (`pip install followthrough[training]`). Nothing outside this package imports it."""
