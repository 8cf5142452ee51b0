# SPDX-License-Identifier: GPL-3.0-or-later
"""What a measurement was made on."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from followthrough import __version__


@dataclass(frozen=True)
class Machine:
    """A machine, and what of it was at hand.

    Attributes
    ----------
    processor
        As it calls itself.
    cores
        That this process may use.
    load
        Processes that wanted a core in the minute before; None where the system does not say. Above 0.5 or so, others were at work.
    system, python, numpy, followthrough
        Versions.
    """

    processor: str
    cores: int
    load: float | None
    system: str
    python: str
    numpy: str
    followthrough: str


def this_machine() -> Machine:
    """The machine that this runs on."""
    return Machine(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        load=round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        python=platform.python_version(),
        numpy=np.__version__,
        followthrough=__version__,
    )


def _processor() -> str:
    described = Path("/proc/cpuinfo")
    if described.is_file():
        for line in described.read_text(errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine() or "unknown"
