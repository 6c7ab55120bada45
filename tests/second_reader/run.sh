#!/usr/bin/env bash
# Reads the golden bundles with the second reader and compares their paths with what geofan found: in the metric, points
# to 1/20 of the promise times s, tangents to a quarter of it (docs/FORMAT.md, section 11).
# Usage: tests/second_reader/run.sh [PATHS.json]; needs Python 3.11 or newer and PyPI. Exit code 0: all paths agree;
# 1: some do not; 2: a bundle is damaged. The environment is made under target/ and kept; VENV names another place.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
venv=${VENV:-$here/../../target/second-reader}
if [[ ! -x $venv/bin/python ]]; then python3 -m venv "$venv"; fi
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$here/requirements.txt"
"$venv/bin/python" -B "$here/read_bundle.py" compare "${1:-$here/../golden/paths.json}"
