#!/usr/bin/env bash
# Builds the viewer for pages, `geofan-web` for wasm32-unknown-unknown, and puts it beside the program, where
# `geofan view --page` finds it. Equal sources and compilers give equal bytes. Binaryen, in the version of
# tests/browser/package-lock.json, makes it smaller and faster; where there is no npm it stays as the
# compiler made it. Needs Rust 1.92 or later. To check that the bytes are the same: run it in two folders with the same
# commit, each with a CARGO_TARGET_DIR of its own, and `cmp` the two files.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

target=wasm32-unknown-unknown
sysroot=$(rustc --print sysroot)
if [[ ! -d $sysroot/lib/rustlib/src/rust/library ]]; then
    rustup component add rust-src
fi

# The standard library is built too, so that a panic, of which a page tells nothing but that the viewer has ended, ends
# it without a text: a twentieth of the bytes less. A stable compiler takes these settings by RUSTC_BOOTSTRAP.
# Paths of this machine are no part of the result.
export RUSTC_BOOTSTRAP=1
# Pieces compiled by themselves come out larger.
export CARGO_INCREMENTAL=0
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_RUSTFLAGS="-C target-feature=+simd128 \
    -Z unstable-options -C panic=immediate-abort --remap-path-prefix=$PWD=. \
    --remap-path-prefix=${CARGO_HOME:-$HOME/.cargo}=cargo --remap-path-prefix=$sysroot=rust"
cargo build --locked --profile web -p geofan-web --target "$target" -Z build-std=std,panic_abort \
    -Z build-std-features=optimize_for_size

folder="${CARGO_TARGET_DIR:-target}"
built="$folder/$target/web/geofan_web.wasm"
mkdir -p "$folder/release"
ready="$folder/release/geofan-web.wasm"
if command -v npm >/dev/null; then
    (cd tests/browser && npm ci --ignore-scripts --no-audit --no-fund --silent)
    # The features that the target has by itself, and vectors. Functions with one caller stay functions unless they are
    # short: else two become 200 kB long, and browsers compile them again for seconds while the first picture waits.
    # -Os, or less inlining of others, makes it up to one per cent smaller and pictures 15 per cent slower.
    node --stack-size=4000 tests/browser/node_modules/.bin/wasm-opt -O3 --one-caller-inline-max-function-size=80 \
        --enable-simd --enable-bulk-memory \
        --enable-nontrapping-float-to-int --enable-sign-ext --enable-mutable-globals --enable-reference-types \
        --enable-multivalue --strip-producers --strip-target-features "$built" -o "$ready.part"
    mv "$ready.part" "$ready"
else
    cp "$built" "$ready"
fi
printf '%s: %s bytes\n' "$ready" "$(stat -c %s "$ready" 2>/dev/null || stat -f %z "$ready")"
