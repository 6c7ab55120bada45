#!/usr/bin/env bash
# Counts the instructions of fixed pieces of work on one thread (`benches/counts.rs`): a frame by table, a bundle that
# is opened with its first camera, a bake, a hundred thousand exact rays. Compares them with docs/counts.txt, and ends
# with exit code 1 if one is more than 3 % larger; 5 % for the bake, whose threads wait for each other. A count differs
# by 0.01 % from run to run, also on a machine under load, where a time means little.
# Usage: docs/counts.sh [--record] [CASE...]; --record writes the counts down instead. Needs valgrind and jq; two
# minutes. Valgrind knows no AVX-512: it counts what is done with vectors of 32 bytes, on any machine that has them.
# Builds without incremental compilation, which divides crates otherwise: its counts are up to 5 % larger.
set -euo pipefail
export CARGO_INCREMENTAL=0
cd "$(dirname "${BASH_SOURCE[0]}")/.."
recorded=docs/counts.txt
record=no
if [[ ${1-} == --record ]]; then
    record=yes
    shift
fi
[[ $# -gt 0 ]] || set -- frame decode bake rays
program=$(cargo test --locked --release --workspace --no-run --bench counts --message-format=json 2>/dev/null |
    jq -r 'select(.target.name? == "counts" and .executable) | .executable')

# Of a bake, which other threads work on, all is counted.
instructions() {
    local only=(--toggle-collect='*counts*counted*')
    [[ $1 != bake ]] || only=()
    valgrind --tool=callgrind --callgrind-out-file=/dev/null "${only[@]}" "$program" "$1" 2>&1 |
        sed -n 's/^==.*Collected : //p'
}

limit() {
    case $1 in
    bake) echo 5 ;;
    *) echo 3 ;;
    esac
}

bad=0
for name in "$@"; do
    count=$(instructions "$name")
    before=$(awk -v n="$name" '$1 == n { print $2 }' "$recorded")
    if [[ $record == yes ]]; then
        sed -i "/^$name /d" "$recorded"
        echo "$name $count" >>"$recorded"
    fi
    awk -v n="$name" -v c="$count" -v b="${before:-0}" -v limit="$(limit "$name")" 'BEGIN {
        if (!b) { printf "%-8s %14.0f  not recorded\n", n, c; exit }
        percent = 100 * (c / b - 1)
        worse = percent > limit
        printf "%-8s %14.0f  %+.2f %%%s\n", n, c, percent, worse ? "  TOO MANY" : ""
        exit worse
    }' || bad=1
done
[[ $record == yes ]] || exit $bad
