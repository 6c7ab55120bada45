#!/usr/bin/env bash
# How far interpolation between paths keeps its budget (0.5 mrad) in every scene of the gallery: a row of a table for each,
# with the errors that the lattice adds at the middles of all pixels, the share of pixels that are off by more than four
# budgets, and the share of those that are so because an edge is moved, by two budgets at most. Usage:
# docs/lattice.sh [-k FOLDER] [SCENE...]; needs `cargo build --release --workspace` and jq. Pictures are 640 × 360, or SIZE.
# Bakes what it needs, some minutes in all; -k keeps bundles and pictures of the errors.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=''
while getopts k: option; do
    case $option in
    k) out=$OPTARG && mkdir -p "$out" ;;
    *) exit 2 ;;
    esac
done
shift $((OPTIND - 1))
if [[ -z $out ]]; then
    out=$(mktemp -d)
    trap 'rm -rf "$out"' EXIT
fi
size=${SIZE:-640x360}

bake() { # name, arguments
    local name=$1 manifold=assets/manifolds/$1.toml
    shift
    [[ -e $out/$name.fan ]] && return
    if [[ $name == three-bumps ]]; then # a rail through the scene's camera
        manifold=$out/three-bumps.toml
        sed -e 's|^parameters = { c.*|parameters = { c = [-2.0, 2.0] }|' -e 's|^at = \["c.*|at = ["c", "0.2", "0.3"]|' \
            assets/manifolds/three-bumps.toml >"$manifold"
    fi
    target/release/geofan-bake "$manifold" -o "$out/$name.fan" --max-error 0.5 --certify-rays 2000 --quiet "$@" >/dev/null || true
}

row() { # scene, bundle, name of the row, arguments of compare
    local scene=$1 bundle=$2 name=$3
    shift 3
    target/release/geofan compare "assets/scenes/$scene.toml" --bundle "$out/$bundle.fan" --out "$out/$name" --size "$size" \
        --lattice --quiet --json "$@" 2>/dev/null |
        jq -r --arg n "$name" 'def percent: 1e6 * . | round / 1e4;
            "| \($n) | \(.lattice_mrad.p50 * 100 | round / 100), \(.lattice_mrad.p99 * 100 | round / 100), \(.lattice_mrad.max * 10 | round / 10) | \(.lattice_beyond | percent) | \(.lattice_edges | percent) |"'
}

make() {
    case $1 in
    wormhole)
        bake ellis-wormhole
        for view in near throat far; do row wormhole-gallery ellis-wormhole "wormhole-$view" --view "$view"; done
        ;;
    three-bumps) bake three-bumps && row three-bumps-gallery three-bumps "$1" ;;
    nil-twist) bake nil && row "$1" nil "$1" ;;
    s3-*) bake s3 --length 6.6 && row "$1" s3 "$1" ;;
    h3-lamp) bake h3-ball && row "$1" h3-ball "$1" ;;
    black-hole-ring) bake schwarzschild && row "$1" schwarzschild "$1" ;;
    black-hole-planet) bake schwarzschild && row "$1" schwarzschild "$1" --at-time 30 ;;
    black-hole-fall) bake schwarzschild-rain && row "$1" schwarzschild-rain "$1" ;;
    bump-caustic) bake gaussian-bump && row "$1" gaussian-bump "$1" ;;
    half-turn-carried) bake half-turn && row "$1" half-turn "$1" ;;
    poincare-letters) bake poincare && row "$1" poincare "$1" ;;
    kerr-disc) bake kerr && row "$1" kerr "$1" ;;
    glass-ball | seifert-weber | road-mirage | portal) bake "$1" && row "$1" "$1" "$1" ;;
    *)
        echo "there is no scene $1" >&2
        exit 2
        ;;
    esac
}

if [[ $# -eq 0 ]]; then
    # Kerr's region takes an hour to bake.
    set -- wormhole three-bumps nil-twist s3-own-back s3-lamp s3-carried h3-lamp black-hole-ring black-hole-planet black-hole-fall \
        bump-caustic half-turn-carried poincare-letters glass-ball seifert-weber road-mirage portal
fi
echo '| scene | p50, p99, largest, mrad | off by more than four budgets, % | at edges, % |'
echo '|---|---|---|---|'
for scene in "$@"; do make "$scene"; done
