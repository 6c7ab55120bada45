#!/usr/bin/env bash
# The sweep behind docs/study.md: bundles, figures, page and CSV go to the folder given (default:
# study), and what the study shows to docs/. About an hour on two cores; run it again to go on after
# an interruption. Usage: docs/study.sh [DIR]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-study}
cargo build --release -p geofan-bake

mkdir -p "$out"
floor=$out/three-bumps-floor.toml
sed -e 's|^name = .*|name = "Three bumps, floor"|' \
    -e 's|^parameters = { c.*|parameters = { cx = [-2.0, 2.0], cy = [-2.0, 2.0] }|' \
    -e 's|^at = \["c.*|at = ["cx", "cy", "0.2"]|' assets/manifolds/three-bumps.toml >"$floor"
target/release/geofan-bake sweep --out "$out" \
    assets/manifolds/{ellis-wormhole,schwarzschild,s3,nil,sol,gaussian-bump}.toml \
    docs/ridge.toml "$floor" assets/manifolds/{gaussian-lens,three-bumps}.toml

images=docs/images/study
rm -rf "$images"
mkdir -p "$images"
take() { for figure in "$@"; do cp "$out/figures/$figure" "$images"; done; }
(cd "$out/figures" && ls -- *-error-bytes.svg) | while read -r figure; do take "$figure"; done
take sol-error-lookup.svg schwarzschild-error-{lookup,bake}.svg gaussian-lens-error-bake.svg
for map in schwarzschild ellis-wormhole three-bumps-floor; do
    take "$map"-map-camera-{patches,cubic-u16}.png
done
take schwarzschild-map-direction-{patches,cubic-u16}.png
cp "$out/sweep.csv" docs/study.csv
