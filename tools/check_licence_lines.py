# SPDX-License-Identifier: GPL-3.0-or-later
"""Check that every source file names its licence in its first three lines."""

import subprocess
import sys
from pathlib import Path

SUFFIXES = {".cpp", ".hpp", ".py", ".sh", ".cmake", ".toml", ".yml", ".yaml"}
NAMES = {"CMakeLists.txt", "Makefile", "run"}


def main() -> None:
    """Exit with 1 and name the files that lack the line."""
    root = Path(__file__).parents[1]
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout.split("\n")
    named = (root / name for name in listed if name and (Path(name).suffix in SUFFIXES or Path(name).name in NAMES))
    missing = [
        path
        for path in named
        if path.is_file()
        and "SPDX-License-Identifier: " not in "".join(path.read_text(encoding="utf-8").splitlines(True)[:3])
    ]
    for path in missing:
        print(f"{path.relative_to(root)}: no SPDX-License-Identifier in its first three lines")
    sys.exit(1 if missing else 0)


if __name__ == "__main__":
    main()
