#!/usr/bin/env bash
# Lists the licences of every crate in the page, the program and the Python wheel: docs/licences.md.
# `cargo deny check` holds them against deny.toml. Usage: docs/licences.sh >docs/licences.md
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

list() { # title, arguments of cargo tree
    printf '\n## %s\n\n| crate | version | licence |\n|---|---|---|\n' "$1"
    shift
    cargo tree --locked -e normal --prefix none --format '{p}|{l}' "$@" |
        sed 's/ (\*)//; s/ (proc-macro)//; s/ (\/[^)]*)//' | sort -u |
        sed -nE 's/^([^ ]+) v([^| ]+)\|(.*)$/| \1 | \2 | \3 |/p'
}

printf '# Licences of what is shipped\n\nMade by `docs/licences.sh`. geofan itself is under the MIT licence.\n'
list 'The page (WebAssembly)' -p geofan-web --target wasm32-unknown-unknown
list 'The program' -p geofan
list 'The Python package' --manifest-path python/Cargo.toml
