#!/usr/bin/env bash
# The table "Accuracy and size" of the README: bakes each row, then checks it with 100,000 fresh
# rays. Usage: docs/accuracy.sh [ROW...]; needs `cargo build --release --workspace` and jq.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=$(mktemp -d)

row() { # manifold, promise, length
    local name=$1 promise=$2 length=$3 bake check
    bake=$(target/release/geofan-bake "assets/manifolds/$name.toml" -o "$out/$name.fan" \
        --max-error "$promise" --length "$length" --quiet --json) || true
    check=$(target/release/geofan check "$out/$name.fan" --rays 100000 --quiet --json) || true
    jq -rn --argjson b "$bake" --argjson c "$check" --arg n "$name" --arg p "$promise" --arg l "$length" \
        '"| \($n), length \($l) | \($p) | \($c.bytes) | \($c.screen_mrad.p50) | \($c.screen_mrad.p95) | \($c.screen_mrad.p99) | \($c.screen_mrad.max) | \(100 * $c.flagged) % | \($b.seconds) s |"'
}

rows=("s3 0.05 3" "h3-ball 0.05 3" "nil 0.05 5" "sol 0.05 5" "schwarzschild 0.1 80"
    "ellis-wormhole 0.2 24" "interstellar-wormhole 0.2 24")
for r in "${rows[@]}"; do
    # shellcheck disable=SC2086
    if [[ $# -eq 0 || " $* " == *" ${r%% *} "* ]]; then row $r; fi
done
