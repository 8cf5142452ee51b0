# SPDX-License-Identifier: GPL-3.0-or-later
"""Training of the emulator in PyTorch (`pip install followthrough[training]`).

Outside this package only the benchmark of other runtimes imports it.
"""
