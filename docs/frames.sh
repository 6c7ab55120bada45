#!/usr/bin/env bash
# The table "Speed" of docs/results.md: frames of a moving, turning camera by table against exact ones and
# against equal-error exact, one sample a pixel. Usage: docs/frames.sh [ROW...]; needs
# `cargo build --release --workspace` and jq. Bakes what it needs, a minute in all.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=$(mktemp -d)
size=640x360
cp -r assets "$out/assets"

# name, scene, bundle, further arguments of compare
row() {
    local name=$1 scene=$2 bundle=$3
    shift 3
    target/release/geofan compare "$scene" --bundle "$bundle" --out "$out/pictures" --size "$size" --spp 1 \
        --quiet --json "$@" |
        jq -r --arg n "$name" 'def ms: 1000 * . | round;
            "| \($n) | \(.table.frame | ms) | \(.exact.frame | ms) | \(.equal_error.times.frame | ms) | \(.equal_error.lattice_times.frame | ms) | \(.paths_ns.table | round) / \(.paths_ns.exact | round) / \(.paths_ns.equal_error | round) | \(100 * .lattice_mrad.p99 | round / 100), \(100 * .lattice_mrad.max | round / 100) |"'
}

bake() { # manifold file, name, promise, further arguments
    local manifold=$1 bundle=$out/$2.fan promise=$3
    shift 3
    [[ -e $bundle ]] || target/release/geofan-bake "$manifold" -o "$bundle" --max-error "$promise" --quiet "$@" >/dev/null || true
}

ellis() { bake assets/manifolds/ellis-wormhole.toml ellis 0.15; }

# The near half of the wormhole gallery in another space: the same meshes at the same chart points.
elsewhere() { # manifold, promise, sky lines, further arguments
    local manifold=$1 promise=$2 skies=$3 scene=$out/assets/scenes/$1.toml
    shift 3
    sed -e "s|^manifold = .*|manifold = \"../manifolds/$manifold.toml\"|" -e '/^# far side/,$d' \
        -e '/^\[\[view\]\]/,/^$/d' assets/scenes/wormhole-gallery.toml >"$scene"
    printf '[sky]\n%b' "$skies" >>"$scene"
    bake "$out/assets/manifolds/$manifold.toml" "$manifold" "$promise" "$@"
    row "same meshes, $manifold" "$scene" "$out/$manifold.fan" "$@"
}

# Flat space by a metric that takes long to evaluate: what a frame owes to the cost of expressions alone.
costly() {
    local one='1' pair
    for pair in x*y y*z z*x x+y y+z z+x; do one="$one * (sin($pair)^2 + cos($pair)^2)"; done
    sed "s|conformal = \"1\"|conformal = \"$one\"|" assets/manifolds/flat.toml >"$out/assets/manifolds/costly-flat.toml"
    elsewhere costly-flat 0.2 'sky = { pattern = "grid" }\n'
}

# One sphere of 2 n² triangles beside the camera's way.
sphere() {
    local n=$1 scene=$out/assets/scenes/sphere-$1.toml
    awk -v n="$n" 'BEGIN {
        pi = atan2(0, -1)
        for (i = 0; i <= n; i++) for (j = 0; j <= n; j++) {
            a = pi * i / n; b = 2 * pi * j / n
            printf "v %.9f %.9f %.9f\n", sin(a) * cos(b), sin(a) * sin(b), cos(a)
        }
        for (i = 0; i < n; i++) for (j = 1; j <= n; j++) {
            k = i * (n + 1) + j
            printf "f %d %d %d\nf %d %d %d\n", k, k + 1, k + n + 1, k + 1, k + n + 2, k + n + 1
        }
    }' >"$out/assets/meshes/sphere-$n.obj"
    sed -e '/^\[\[object\]\]/,$d' assets/scenes/wormhole-gallery.toml >"$scene"
    printf '[[object]]\nmesh = "../meshes/sphere-%s.obj"\nat = [1.9, 0.4, 0.2]\nscale = 0.7\n' "$n" >>"$scene"
    printf '[sky]\nnear = { pattern = "grid" }\nfar = { pattern = "stars" }\n' >>"$scene"
    ellis
    row "a sphere of $((2 * n * n)) triangles" "$scene" "$out/ellis.fan"
}

bumps() {
    sed -i -e 's|^parameters = .*|parameters = { c = [-2.0, 2.0] }|' -e 's|^at = \["cx".*|at = ["c", "0.2", "0.3"]|' \
        "$out/assets/manifolds/three-bumps.toml"
    bake "$out/assets/manifolds/three-bumps.toml" bumps 0.5
    row "three bumps, from a rail" "$out/assets/scenes/three-bumps-gallery.toml" "$out/bumps.fan"
}

gallery() {
    local name=$1
    shift
    ellis
    row "wormhole gallery, $name" assets/scenes/wormhole-gallery.toml "$out/ellis.fan" "$@"
}

make() {
    case $1 in
    near | throat | far) gallery "$1" --view "$1" ;;
    large) size=1280x720 gallery "near, 1280 × 720" --view near ;;
    one-thread) gallery "near, one thread" --view near --threads 1 ;;
    bumps) bumps ;;
    flat) elsewhere flat 0.2 'sky = { pattern = "grid" }\n' ;;
    costly-flat) costly ;;
    interstellar) elsewhere interstellar-wormhole 0.2 'near = { pattern = "grid" }\nfar = { pattern = "stars" }\n' --set a=0.5 --set W=0.43 ;;
    ellis) elsewhere ellis-wormhole 0.2 'near = { pattern = "grid" }\nfar = { pattern = "stars" }\n' ;;
    sphere-*) sphere "${1#sphere-}" ;;
    *)
        echo "there is no row $1" >&2
        exit 2
        ;;
    esac
}

if [[ $# -eq 0 ]]; then
    set -- near throat far large one-thread bumps flat costly-flat ellis interstellar sphere-70 sphere-224 sphere-707
fi
for r in "$@"; do make "$r"; done
