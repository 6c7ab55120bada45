#!/usr/bin/env bash
# Makes the bundles of tests/corpus/bundle: tiny ones, of every kind of space and table that a file can hold. Again after
# a change of the format. Needs `cargo build --release --workspace`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

bundle() { # name, manifold without its first lines, further arguments of the bake
    local name=$1 text=$2 code=0
    shift 2
    printf 'name = "%s"\ncoordinates = ["x", "y", "z"]\n%s\n' "$name" "$text" >"$work/$name.toml"
    target/release/geofan bake "$work/$name.toml" -o "tests/corpus/bundle/$name.fan" --quiet \
        --max-error 300 --certify-rays 100 "$@" || code=$?
    [[ $code -le 1 ]]
}

lens='metric = { conformal = "1 + 0.1*exp(-x^2 - y^2 - z^2)" }'
sky='[[exit]]
name = "sky"
when = "x^2 + y^2 + z^2 - 4"'
rail='[cameras]
parameters = { c = [0.5, 0.7] }
at = ["c", "0.1", "0"]
length = 1.5'
bundle rotation "$lens"$'\n'"$sky"$'\n[symmetry]\nrotation = "origin"\n[cameras]\nparameters = { c = [0.5, 1] }\nat = ["c", "0", "0"]\nlength = 3'
bundle rail "$lens"$'\n'"$sky"$'\n'"$rail"
bundle points "$lens"$'\n'"$rail" --no-frames
bundle axis $'metric = { conformal = "1 + 0.1*exp(-z^2)" }\nwind = ["0.1*y", "-0.1*x", "0"]\n[symmetry]\nrotation = "z"\n'"$rail"
bundle group $'metric = { xx = "1", yy = "1", zz = "1" }\n[symmetry]\ngroup = ["x + px", "y + py", "z + pz"]\n[cameras]\nlength = 2'
bundle edge $'metric = { conformal = "if(x^2 + y^2 + z^2 < 0.09, 1.2, 1)" }\n[symmetry]\nrotation = "origin"\n[cameras]\nparameters = { c = [0.5, 0.6] }\nat = ["c", "0", "0"]\nlength = 1'
bundle graph $'embedding = ["x", "y", "z", "0.3*exp(-x^2)"]\n[symmetry]\ntranslation = ["y", "z"]\n[cameras]\nparameters = { c = [0.5, 0.7] }\nat = ["c", "0", "0"]\nlength = 1'
printf '\0\0\0\0\0\0\200?\0\0\0\0\0\0\200?' >"$work/samples.raw"
bundle field $'metric = { conformal = "1 + 0.05*F(x, y, z)" }\n[field.F]\nfile = "samples.raw"\nshape = [4, 1, 1]\ntype = "f32"\ndegree = 3\nbox = { x = [-2, 2] }\n'"$rail"
# And files that are none.
head -c 200 tests/corpus/bundle/rail.fan >tests/corpus/bundle/cut.fan
sed 's/\r$//' tests/corpus/bundle/rail.fan >tests/corpus/bundle/text-mode.fan
