# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m followthrough`: the command line."""

import sys

from followthrough.cli import main

if __name__ == "__main__":
    sys.exit(main())
