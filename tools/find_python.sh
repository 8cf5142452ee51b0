#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Prints a Python interpreter: find_python.sh [VERSION or PATH]. Without an argument: the first of 3.11 and 3.13, else a python3 that is
# newer than 3.11. Looks on the PATH and among pyenv's versions.
set -euo pipefail
wanted=${1:-}

usable() { "$1" -c "import sys; raise SystemExit(not ($2))" 2>/dev/null; }
candidates() {
  local name path
  for name in "$@"; do command -v "$name" || true; done
  for path in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin/python; do if [ -x "$path" ]; then echo "$path"; fi; done
}
first() { # CONDITION NAME...
  local condition=$1 path
  shift
  while IFS= read -r path; do
    if usable "$path" "$condition"; then echo "$path"; return 0; fi
  done < <(candidates "$@")
  return 1
}

case $wanted in
*/* | python*) if usable "$wanted" "sys.version_info >= (3, 11)"; then command -v "$wanted"; exit; fi ;;
"") first "sys.version_info[:2] in ((3, 11), (3, 13))" python3 python3.11 python3.13 && exit
  first "sys.version_info >= (3, 11)" python3 && exit ;;
*) first "'%d.%d' % sys.version_info[:2] == '$wanted'" "python$wanted" python3 && exit ;;
esac
echo "find_python: found no Python ${wanted:-3.11 or newer}; install it (Debian: apt install python3 python3-venv) or name one with PYTHON=..." >&2
exit 1
