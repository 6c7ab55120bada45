#!/usr/bin/env bash
# A medium by its samples beside the same by its formula: a Gaussian lens by 33^3 samples in single precision, its table's
# bytes and errors, its frames (compare: by table, exact, equal-error exact, the same with a lattice, in one run each).
# Usage: docs/field.sh; needs `cargo build --release --workspace`, python3 and jq; two minutes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
cp -r assets/meshes "$out/meshes"

python3 - "$out/lens.npy" <<'PYTHON'
import math, struct, sys

places = [5 * (i / 16 - 1) for i in range(33)]
header = "{'descr': '<f4', 'fortran_order': False, 'shape': (33, 33, 33), }"
# Ten bytes before it, a line break after it.
header += " " * (-(len(header) + 11) % 64) + "\n"
with open(sys.argv[1], "wb") as file:
    file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode())
    for x in places:
        for y in places:
            for z in places:
                file.write(struct.pack("<f", 0.5 * math.exp(-(x * x + y * y + z * z) / 2)))
PYTHON

manifold() { # name, the metric
    cat >"$out/$1.toml" <<TOML
name = "Lens by its $1"
coordinates = ["x", "y", "z"]
$2
[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 24"
[cameras]
parameters = { c = [2.0, 3.0] }
at = ["c", "0.2", "0.1"]
length = 9.0
TOML
    cat >"$out/scene-$1.toml" <<TOML
manifold = "$1.toml"
[camera]
parameters = { c = 2.5 }
look = [-1, 0, 0]
up = [0, 0, 1]
fov = 90
[[object]]
mesh = "meshes/teapot.obj"
at = [-1.0, 0.3, -0.2]
scale = 0.5
[[object]]
mesh = "meshes/globe.obj"
at = [0.4, -0.7, 0.3]
scale = 0.3
[sky]
sky = { pattern = "grid" }
TOML
}
manifold formula 'metric = { conformal = "exp(0.5*exp(-(x^2 + y^2 + z^2)/2))" }'
manifold samples 'metric = { conformal = "exp(f(x, y, z))" }
[field.f]
file = "lens.npy"
box = { x = [-5, 5], y = [-5, 5], z = [-5, 5] }'

echo '| lens by | bytes | screen p99, mrad | frame, ms: table | exact | equal-error exact | the same with a lattice | paths, ns a pixel: table | equal-error exact with a lattice |'
echo '|---|---|---|---|---|---|---|---|---|'
for name in formula samples; do
    target/release/geofan-bake "$out/$name.toml" -o "$out/$name.fan" --quiet >/dev/null
    p99=$(target/release/geofan check "$out/$name.fan" --rays 20000 --quiet --json | jq '.screen_mrad.p99 * 1e3 | round / 1e3')
    target/release/geofan compare "$out/scene-$name.toml" --bundle "$out/$name.fan" --out "$out/pictures" --size 640x360 --spp 1 \
        --quiet --json "$@" |
        jq -r --arg n "$name" --arg b "$(stat -c %s "$out/$name.fan")" --arg p "$p99" 'def ms: 1e4 * . | round / 10;
            "| its \($n) | \($b) | \($p) | \(.table.frame | ms) | \(.exact.frame | ms) | \(.equal_error.times.frame | ms) | \(.equal_error.lattice_times.frame | ms) | \(.paths_ns.table | round) | \(.paths_ns.equal_error_lattice | round) |"'
done
