#!/usr/bin/env bash
# What is shipped and what it needs: the oldest Rust that is promised, and licences, sources and known
# vulnerabilities of every crate. Installs the toolchain where it is missing and can be had, and with --install
# cargo-deny (a quarter of an hour).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

oldest=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
if rustup run "$oldest" rustc --version || rustup toolchain install "$oldest" --profile minimal; then
    CARGO_TARGET_DIR=target/oldest cargo "+$oldest" check --locked --workspace
else
    echo "Rust $oldest cannot be had: not checked" >&2
fi

# The list of licences is that of today's dependencies.
diff <(docs/licences.sh) docs/licences.md

[[ ${1:-} != --install ]] || cargo deny --version || cargo install --locked cargo-deny
if cargo deny --version 2>/dev/null; then
    cargo deny --locked check
    cargo deny --locked --manifest-path python/Cargo.toml check --config deny.toml
else
    echo "cargo-deny is not installed: not checked" >&2
fi
