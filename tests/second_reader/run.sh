#!/usr/bin/env bash
# Reads the golden bundles with the second reader and compares their paths with what geofan found.
# Usage: tests/second_reader/run.sh [TOLERANCE]; needs Python 3.11 or newer and PyPI. Exit code 0: all paths agree.
# The environment is made under target/ and kept; VENV names another place.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
venv=${VENV:-$here/../../target/second-reader}
if [[ ! -x $venv/bin/python ]]; then python3 -m venv "$venv"; fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$here/requirements.txt"
"$venv/bin/python" -B "$here/read_bundle.py" compare "$here/../golden/paths.json" --tolerance "${1:-1e-9}"
