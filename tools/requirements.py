# SPDX-License-Identifier: GPL-3.0-or-later
"""Print what to install before the package itself: its build requirements, dependencies and the named extras, from pyproject.toml."""

import sys
import tomllib
from pathlib import Path


def main() -> None:
    """Print one requirement a line."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    wanted = [*project["build-system"]["requires"], "cmake>=3.24", "ninja", *project["project"]["dependencies"]]
    for extra in sys.argv[1:]:
        wanted += extras[extra]
    print("\n".join(dict.fromkeys(wanted)))


if __name__ == "__main__":
    main()
