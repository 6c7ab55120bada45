"""Holds the package's rays per second against those of the Rust library, in one run each.

    cargo build --release --example rates
    python python/tests/throughput.py target/release/examples/rates

Both sides follow the same rays, with as many threads, and take turns. Each side's best time counts: what else the
machine does only takes time. Ends with exit code 1 if either rate is below 80 % of the library's.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import geofan as gf
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
EXACT, TABLE, REPEATS, ROUNDS = 100_000, 1_000_000, 2, 6


def directions(count):
    """Spreads directions evenly, along a spiral of the golden angle."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    r, angle = np.sqrt(1 - z * z), np.pi * (3 - np.sqrt(5)) * i
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)


def rate(rays, work):
    """Measures rays per second; the fastest repetition counts."""
    best = 0.0
    for _ in range(REPEATS):
        began = time.perf_counter()
        work()
        best = max(best, rays / (time.perf_counter() - began))
    return best


def main(program):
    path = ROOT / "assets" / "manifolds" / "ellis-wormhole.toml"
    manifold, at = gf.Manifold(path), [3.0, 0.4, 0.2]
    few, many = directions(EXACT), directions(TABLE)
    with tempfile.TemporaryDirectory() as folder:
        table = manifold.bake(0.5, out=Path(folder) / "table.fan", certify_rays=1000)
        s = np.arange(4) * table.length / 3
        rates = {kind: {"Python": [], "Rust": []} for kind in ("exact", "table")}
        for _ in range(ROUNDS):
            line = [program, path, table.path, ",".join(map(str, at))]
            rust = json.loads(subprocess.run(line, check=True, capture_output=True, text=True).stdout)
            mine = {
                "exact": rate(EXACT, lambda: manifold.trace(at, few, table.length, tolerance=1e-8)),
                "table": rate(TABLE, lambda: table.paths(at, many, s)),
            }
            for kind, found in rates.items():
                found["Python"].append(mine[kind])
                found["Rust"].append(rust[kind])
                print(f"{kind}: Python {mine[kind]:,.0f} rays/s, Rust {rust[kind]:,.0f} rays/s", flush=True)
    shares = {kind: max(found["Python"]) / max(found["Rust"]) for kind, found in rates.items()}
    print("best against best:", {kind: f"{share:.0%}" for kind, share in shares.items()})
    return min(shares.values()) >= 0.8


if __name__ == "__main__":
    sys.exit(0 if main(sys.argv[1]) else 1)
