#!/usr/bin/env bash
# The sweep behind docs/study.md: bundles, figures, page and CSV go to the folder given (default:
# study), and what the study shows to docs/. One to two hours on two cores; run it again to go on after
# an interruption. Usage: docs/study.sh [DIR]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-study}
cargo build --release --workspace

mkdir -p "$out"
floor=$out/three-bumps-floor.toml
sed -e 's|^name = .*|name = "Three bumps, floor"|' \
    -e 's|^parameters = { c.*|parameters = { cx = [-2.0, 2.0], cy = [-2.0, 2.0] }|' \
    -e 's|^at = \["c.*|at = ["cx", "cy", "0.2"]|' assets/manifolds/three-bumps.toml >"$floor"
sweep() { target/release/geofan-bake sweep "$@"; }
sweep --out "$out" assets/manifolds/{ellis-wormhole,schwarzschild,s3,nil,sol,gaussian-bump}.toml \
    docs/ridge.toml "$floor" assets/manifolds/gaussian-lens.toml
# Its bundle at 60 mrad already takes most of the time that a sweep waits for one.
sweep --out "$out/three-bumps" assets/manifolds/three-bumps.toml --max-error 60

images=docs/images/study
rm -rf "$images"
mkdir -p "$images"
cp "$out"/figures/*-error-bytes.svg "$out"/three-bumps/figures/*-error-bytes.svg "$images"
take() { for figure in "$@"; do cp "$out/figures/$figure" "$images"; done; }
take sol-error-lookup.svg schwarzschild-error-{lookup,bake}.svg gaussian-lens-error-bake.svg
for map in schwarzschild ellis-wormhole three-bumps-floor; do
    take "$map"-map-camera-{patches,cubic-u16}.png
done
take schwarzschild-map-direction-{patches,cubic-u16}.png
{ cat "$out"/sweep.csv; tail -n +2 "$out"/three-bumps/sweep.csv; } >docs/study.csv
