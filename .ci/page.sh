#!/usr/bin/env bash
# Builds the viewer for pages, `geofan-web` for wasm32-unknown-unknown, and puts it beside the program, where
# `geofan view --page` finds it. Equal sources and compilers give equal bytes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

target=wasm32-unknown-unknown
if ! ls "$(rustc --print target-libdir --target "$target")"/libstd-*.rlib >/dev/null 2>&1; then
    rustup target add "$target"
fi

# Paths of this machine are no part of the result.
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS="-C target-feature=+simd128 \
    --remap-path-prefix=$PWD=. --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=cargo"
cargo build --locked --profile web -p geofan-web --target "$target"

folder="${CARGO_TARGET_DIR:-target}"
built="$folder/$target/web/geofan_web.wasm"
mkdir -p "$folder/release"
cp "$built" "$folder/release/geofan-web.wasm"
printf '%s: %s bytes\n' "$folder/release/geofan-web.wasm" "$(stat -c %s "$built" 2>/dev/null || stat -f %z "$built")"
