#!/usr/bin/env bash
# A row of a table for every scene of the gallery, one sample a pixel. `lattice`: how far interpolation between paths keeps
# its budget (0.5 mrad): the errors that it adds at the middles of all pixels, the share of pixels that are off by more than four
# budgets, and the share of those that only edges are moved at. `frames`: what a frame takes by table, exact, equal-error
# exact and that with a lattice of its own, how many times as long as the table that is, and nanoseconds a pixel for the
# table's paths. Usage: docs/gallery.sh [-k FOLDER] lattice|frames [SCENE...]; needs `cargo build --release --workspace` and jq. Bakes what
# it needs, some minutes in all; -k keeps bundles and pictures.
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
what=${1:?lattice or frames}
shift
if [[ -z $out ]]; then
    out=$(mktemp -d)
    trap 'rm -rf "$out"' EXIT
fi
size=${SIZE:-640x360}

bake() { # name, arguments
    local name=$1 manifold=assets/manifolds/$1.toml
    shift
    [[ -e $out/$name.fan ]] && return
    case $name in
    three-bumps) # a rail through the scene's camera
        manifold=$out/three-bumps.toml
        sed -e 's|^parameters = { c.*|parameters = { c = [-2.0, 2.0] }|' -e 's|^at = \["c.*|at = ["c", "0.2", "0.3"]|' \
            assets/manifolds/three-bumps.toml >"$manifold"
        ;;
    kerr) # the scene's camera
        manifold=$out/kerr.toml
        sed -e '/^parameters = { r/d' \
            -e 's|^at = \["sqrt.*|at = ["sqrt(24^2 + a^2)*sqrt(1 - 0.17^2)", "0", "24*0.17"]|' \
            assets/manifolds/kerr.toml >"$manifold"
        ;;
    esac
    target/release/geofan-bake "$manifold" -o "$out/$name.fan" --max-error 0.5 --certify-rays 2000 --quiet "$@" >/dev/null || true
}

row() { # scene, bundle, name of the row, arguments of compare
    local scene=$1 bundle=$2 name=$3 program
    shift 3
    case $what in
    lattice)
        set -- --lattice "$@"
        program='"| \($n) | \(.lattice_mrad.p50 | places(100)), \(.lattice_mrad.p99 | places(100)), \(.lattice_mrad.max | places(10)) | \(100 * .lattice_beyond | places(1e4)) | \(100 * .lattice_edges | places(1e4)) |"'
        ;;
    *)
        set -- --spp 1 "$@"
        program='"| \($n) | \(.table.frame | ms) | \(.exact.frame | ms) | \(.equal_error.times.frame | ms) | \(.equal_error.lattice_times.frame | ms) | \(.equal_error.lattice_times.frame / .table.frame | places(10)) | \(.paths_ns.table | round) |"'
        ;;
    esac
    target/release/geofan compare "assets/scenes/$scene.toml" --bundle "$out/$bundle.fan" --out "$out/$name" --size "$size" \
        --quiet --json "$@" 2>/dev/null |
        jq -r --arg n "$name" "def places(\$by): . * \$by | round / \$by; def ms: 1e4 * . | round / 10; $program"
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
    glass-ball | seifert-weber | figure-eight | road-mirage | portal | lens-space | mirrored-dodecahedron | nil-torus | sol-cat)
        bake "$1" && row "$1" "$1" "$1"
        ;;
    *)
        echo "there is no scene $1" >&2
        exit 2
        ;;
    esac
}

if [[ $# -eq 0 ]]; then
    # Kerr's region takes an hour to bake.
    set -- wormhole three-bumps nil-twist s3-own-back s3-lamp s3-carried h3-lamp black-hole-ring black-hole-planet black-hole-fall \
        bump-caustic half-turn-carried poincare-letters glass-ball seifert-weber figure-eight road-mirage portal \
        lens-space mirrored-dodecahedron nil-torus
fi
case $what in
lattice)
    echo '| scene | p50, p99, largest, mrad | off by more than four budgets, % | at edges, % |'
    echo '|---|---|---|---|'
    ;;
*)
    echo '| scene | table, ms | exact | equal-error exact | the same with a lattice | times the table | paths, ns |'
    echo '|---|---|---|---|---|---|---|'
    ;;
esac
for scene in "$@"; do make "$scene"; done
