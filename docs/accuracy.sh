#!/usr/bin/env bash
# The table "Accuracy and size" of docs/results.md: bakes each row, then checks it with 100,000 fresh
# rays. Usage: docs/accuracy.sh [ROW...]; needs `cargo build --release --workspace` and jq.
# Three minutes; the floor of three bumps, two more, and their box, seven minutes or more, are made
# only when they are named.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=$(mktemp -d)

row() { # row, manifold file, promise, length, further arguments of the bake
    local name=$1 manifold=$2 promise=$3 length=$4 bake check
    shift 4
    bake=$(target/release/geofan-bake "$manifold" -o "$out/$name.fan" \
        --max-error "$promise" --length "$length" --quiet --json "$@") || true
    check=$(target/release/geofan check "$out/$name.fan" --rays 100000 --quiet --json) || true
    jq -rn --argjson b "$bake" --argjson c "$check" --arg n "$name" --arg p "$promise" --arg l "$length" \
        '"| \($n), length \($l) | \($p) | \($c.bytes) | \($c.screen_mrad.p50) | \($c.screen_mrad.p95) | \($c.screen_mrad.p99) | \($c.screen_mrad.max) | \($c.sky_mrad.p99) | \(100 * $c.flagged) % | \($b.seconds) s |"'
}

asset() { echo "assets/manifolds/$1.toml"; }

# Three bumps with another camera region: row, parameters, chart point. The bundle tells the name of the file.
region() {
    local file=$out/$1.toml
    sed -e "s|^parameters = { c.*|parameters = $2|" -e "s|^at = \[\"c.*|at = $3|" "$(asset three-bumps)" >"$file"
    echo "$file"
}

# The chart point of the wormhole's cameras stays as it is.
far_region() {
    sed 's|^parameters = { c = .*|parameters = { c = [-8.0, 8.0] }|' "$(asset ellis-wormhole)" >"$out/ellis.toml"
    echo "$out/ellis.toml"
}

make() {
    case $1 in
    s3 | h3-ball) row "$1" "$(asset "$1")" 0.05 3 ;;
    nil | sol) row "$1" "$(asset "$1")" 0.05 5 ;;
    schwarzschild) row "$1" "$(asset "$1")" 0.1 120 ;;
    ellis-wormhole) row "$1" "$(far_region)" 0.2 28 ;;
    interstellar-wormhole) row "$1" "$(asset "$1")" 0.2 24 --set a=0.5 --set W=0.43 ;;
    three-bumps-rail) row "$1" "$(region "$1" '{ c = [-2.0, 2.0] }' '["c", "0.3", "0.2"]')" 0.5 9.5 ;;
    three-bumps-floor)
        row "$1" "$(region "$1" '{ cx = [-2.0, 2.0], cy = [-2.0, 2.0] }' '["cx", "cy", "0.2"]')" 0.5 9.5
        ;;
    three-bumps) row "$1" "$(asset "$1")" 1.0 8 ;;
    gaussian-lens) row "$1" "$(asset "$1")" 0.3 9 ;;
    *)
        echo "there is no row $1" >&2
        exit 2
        ;;
    esac
}

usual=(
    s3 h3-ball nil sol schwarzschild ellis-wormhole interstellar-wormhole three-bumps-rail gaussian-lens
)
if [[ $# -eq 0 ]]; then set -- "${usual[@]}"; fi
for r in "$@"; do make "$r"; done
