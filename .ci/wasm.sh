#!/usr/bin/env bash
# Builds the reader of bundles for the browser: `geofan-bundle` without threads, files and clocks, for
# wasm32-unknown-unknown. The standard library for that target comes from rustup, or, where rustup
# cannot fetch it, from a distribution's compiler for the web (Debian's rustc-web), unpacked beside the
# build and not installed.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# A browser, a Python module or a GPU tool should not have to take much along.
most=50
crates=$(cargo tree --locked -p geofan-bundle -e normal --prefix none --no-default-features |
    sed 's/ (\*)$//' | sort -u | wc -l)
echo "the reader is made of $crates crates, at most $most"
if ((crates > most)); then
    exit 1
fi

target=wasm32-unknown-unknown
build=(cargo build --locked --release -p geofan-bundle --no-default-features --target "$target")

has_target() {
    "${RUSTC:-rustc}" --print target-libdir --target "$target" 2>/dev/null |
        xargs -I{} sh -c 'ls {}/libstd-*.rlib' >/dev/null 2>&1
}

if ! has_target && command -v rustup >/dev/null; then
    rustup target add "$target" || true
fi
if has_target; then
    exec "${build[@]}"
fi

# Lists of packages may be old or missing on a new machine.
if [[ $(id -u) == 0 ]]; then
    apt-get update -qq || true
fi
# The distribution's sources must be those of a compiler that this workspace accepts.
wanted=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
found=$(apt-cache policy rustc-web 2>/dev/null | sed -n 's/^ *Candidate: \([0-9.]*\).*/\1/p')
if [[ -z $found || $(printf '%s\n%s\n' "$wanted" "$found" | sort -V | head -n 1) != "$wanted" ]]; then
    echo "no standard library for $target: rustup cannot fetch it, and the distribution's rustc-web" \
        "is ${found:-missing} where $wanted is needed. Run 'rustup target add $target' on a machine" \
        "with a connection, or use a distribution with a newer rustc-web." >&2
    exit 3
fi

# Unpacks the compiler, the libraries that it is made of, and the sources of the standard library.
root=$PWD/target/rustc-web
mkdir -p "$root"
needs() { apt-cache depends "$1" | sed -n "s/^ *Depends: \\($2\\)\$/\\1/p" | head -n 1; }
driver=$(needs libstd-rust-web-dev 'libstd-rust-web-[0-9.]*')
llvm=$(needs "${driver:-rustc-web}" 'libllvm[0-9]*')
(
    cd "$root"
    apt-get download rustc-web rust-web-src libstd-rust-web-dev ${driver:+"$driver"} ${llvm:+"$llvm"}
    for package in *.deb; do dpkg-deb -x "$package" .; done
)
libraries=$(find "$root/usr/lib" -name '*.so*' -printf '%h\n' | sort -u | paste -sd:)
linker=$(find "$(rustc --print sysroot)" -name rust-lld -type f | head -n 1)
export LD_LIBRARY_PATH=$libraries RUSTC=$root/usr/bin/rustc RUSTC_BOOTSTRAP=1
export CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=${linker:-rust-lld}
exec "${build[@]}" -Zbuild-std=std,panic_abort
