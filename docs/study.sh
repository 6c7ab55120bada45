#!/usr/bin/env bash
# The sweep behind docs/study.md: figures, page and CSV go to the folder given (default: study), and
# what the study shows to docs/. An hour or two on two cores; run it again to go on after an
# interruption. Usage: docs/study.sh [DIR]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-study}
cargo build --release -p geofan-bake
sweep() { target/release/geofan-bake sweep "$@"; }
sweep assets/manifolds/{ellis-wormhole,schwarzschild,s3,nil,sol,gaussian-bump,gaussian-lens}.toml --out "$out"
# Its bundle at the usual 15 mrad would take hours.
sweep assets/manifolds/three-bumps.toml --max-error 60 --max-error 30 --out "$out/three-bumps"

images=docs/images/study
mkdir -p "$images"
figures=("$out"/figures "$out"/three-bumps/figures)
take() { find "${figures[@]}" -name "$1" -exec cp {} "$images" \;; }
take '*-error-bytes.svg'
take 'sol-error-lookup.svg'
take 'schwarzschild-error-lookup.svg'
take 'schwarzschild-error-bake.svg'
take 'gaussian-lens-error-bake.svg'
for map in schwarzschild ellis-wormhole three-bumps; do
    take "$map-map-camera-patches.png"
    take "$map-map-camera-cubic-u16.png"
done
take 'schwarzschild-map-direction-*.png'
{ cat "$out"/sweep.csv; tail -n +2 "$out"/three-bumps/sweep.csv; } >docs/study.csv
