# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: `followthrough COMMAND ...`. A module a command, imported when it is asked for.

Every module has `add_parser(subparsers)`, which adds the command's arguments, and `run(args) -> int`, which does the
work and returns the exit status. ValueError and OSError are the user's to mend: one line on standard error, status 2.
Interrupted: status 130.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import Any, Protocol

from followthrough import __version__

SubParsers = Any  # argparse keeps the type of add_subparsers' result to itself


class Command(Protocol):
    """A module of this package."""

    def add_parser(self, subparsers: SubParsers) -> None:
        """Add the command's arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Do it and return the exit status."""


#: Module of this package -> the line that the list of commands shows.
COMMANDS = {
    "tetrahedralize": "fill a surface mesh with tetrahedra",
    "simulate": "fill in a sequence's secondary motion with a solver",
    "rollout": "fill in a sequence's secondary motion with the emulator",
    "evaluate": "measure a solver against a sequence's true motion",
    "benchmark": "time every solver beside its error",
    "dataset": "make training sequences",
    "train": "train the emulator's network",
    "fit-springs": "learn the springs' constants from simulated motion",
    "bake": "bake a character's secondary motion to shape keys",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv
        Arguments after the program's name; None: those of this process, after `--` where it is Blender.

    Returns
    -------
    int
        Exit status: 0 done, 2 bad input, 130 interrupted.
    """
    arguments = _own_arguments() if argv is None else list(argv)
    chosen = next((word for word in arguments if not word.startswith("-")), None)
    parser = argparse.ArgumentParser(prog="followthrough", description="Secondary motion for skinned characters.")
    parser.add_argument("--version", action="version", version=f"followthrough {__version__}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    command: Command | None = None
    for name, summary in COMMANDS.items():
        if name == chosen:
            command = importlib.import_module(f"followthrough.cli.{name.replace('-', '_')}")
            command.add_parser(subparsers)
        else:
            subparsers.add_parser(name, help=summary)
    args = parser.parse_args(arguments)
    assert command is not None  # parse_args has exited otherwise
    try:
        return command.run(args)
    except KeyboardInterrupt:
        print("followthrough: interrupted, nothing written", file=sys.stderr)
        return 130
    except (ValueError, OSError) as error:
        print(f"followthrough: error: {_one_line(error)}", file=sys.stderr)
        return 2


def _own_arguments() -> list[str]:
    # Inside `blender --background --python-expr ... -- bake IN -o OUT` what comes before `--` is Blender's.
    return sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())
