# SPDX-License-Identifier: GPL-3.0-or-later
"""For all tests here."""

from __future__ import annotations

import signal

# A shell starts background jobs with interrupts ignored, which every program they start inherits: the tests' programs must hear them.
signal.signal(signal.SIGINT, signal.default_int_handler)
