#!/usr/bin/env bash
# Builds the viewer for pages, `geofan-web` for wasm32-unknown-unknown, and puts it beside the program, where
# `geofan view --page` finds it. Equal sources and compilers give equal bytes. Binaryen, in the version of
# tests/browser/package-lock.json, makes it a sixth smaller; where there is no npm it stays as the compiler made it.
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
ready="$folder/release/geofan-web.wasm"
if command -v npm >/dev/null; then
    (cd tests/browser && npm ci --ignore-scripts --no-audit --no-fund --silent)
    # The features that the target has by itself, and vectors.
    node --stack-size=4000 tests/browser/node_modules/.bin/wasm-opt -O3 --enable-simd --enable-bulk-memory \
        --enable-nontrapping-float-to-int --enable-sign-ext --enable-mutable-globals --enable-reference-types \
        --enable-multivalue "$built" -o "$ready.part"
    mv "$ready.part" "$ready"
else
    cp "$built" "$ready"
fi
printf '%s: %s bytes\n' "$ready" "$(stat -c %s "$ready" 2>/dev/null || stat -f %z "$ready")"
