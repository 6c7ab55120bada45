#!/usr/bin/env bash
# The sweep behind docs/study.md: figures, page and CSV go to the folder given (default: study), and
# the figures that the study shows to docs/images. Run it again to go on after an interruption.
# Usage: docs/study.sh [DIR] [options of `geofan-bake sweep`]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
out=${1:-study}
cargo build --release -p geofan-bake
target/release/geofan-bake sweep \
    assets/manifolds/{ellis-wormhole,schwarzschild,s3,nil,sol,gaussian-bump,gaussian-lens,three-bumps}.toml \
    --out "$out" "${@:2}"

images=docs/images/study
mkdir -p "$images"
cp "$out"/figures/*-error-bytes.svg "$images"
cp "$out"/figures/{sol,schwarzschild}-error-lookup.svg "$images"
cp "$out"/figures/{schwarzschild,three-bumps}-error-bake.svg "$images"
cp "$out"/figures/{schwarzschild,ellis-wormhole,three-bumps}-map-camera-{patches,cubic-u16}.png "$images"
cp "$out"/figures/nil-map-direction-patches.png "$images"
cp "$out"/sweep.csv docs/study.csv
