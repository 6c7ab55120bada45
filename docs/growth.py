#!/usr/bin/env python3
"""Bytes, seconds and memory of a bake against promise, length and region: the tables of docs/growth.md.

    docs/growth.py [SPACE...]        needs `cargo build --release --workspace`

Each row is one bake of `target/release/geofan`; processor time and largest resident memory are those of its process.
The last line of a table is the exponent of a power law between its first and last row.
"""

import math
import os
import re
import subprocess
import sys
import tempfile

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
GEOFAN = os.path.join(ROOT, "target/release/geofan")

# Space: promise (mrad), length and region (a share of the camera intervals about their middle) at which the others are
# measured, and what each is measured at.
SPACES = {
    "schwarzschild": ((1, 120, 0.1), [30, 10, 3, 1, 0.3, 0.1], [1.2, 4, 12, 40, 120], [0.01, 0.03, 0.1, 0.3, 1]),
    "ellis-wormhole": ((1, 28, 0.1), [30, 10, 3, 1, 0.3, 0.1], [0.28, 0.9, 2.8, 9, 28], [0.01, 0.03, 0.1, 0.3, 1]),
    "nil": ((1, 6, 1), [30, 10, 3, 1, 0.3, 0.1], [0.06, 0.2, 0.6, 2, 6], []),
    "three-bumps-rail": ((3, 4, 0.5), [100, 30, 10, 3, 1], [0.1, 0.3, 1, 3, 10], [0.01, 0.03, 0.1, 0.3, 1]),
}


def manifold(space, region, folder):
    """Writes the space with a share of its camera region; a rail is a line of cameras without a symmetry."""
    rail = space.endswith("-rail")
    with open(os.path.join(ROOT, "assets/manifolds", space.removesuffix("-rail") + ".toml")) as file:
        text = file.read()
    if rail:
        text = re.sub(r"(?m)^parameters = \{ c.*", "parameters = { c = [-2.0, 2.0] }", text)
        text = re.sub(r'(?m)^at = \["c.*', 'at = ["c", "0.3", "0.2"]', text)

    def shrink(match):
        low, high = float(match[2]), float(match[3])
        middle, half = 0.5 * (low + high), 0.5 * (high - low) * region
        return f"{match[1]}[{middle - half}, {middle + half}]"

    head, cameras, tail = text.partition("[cameras]")
    tail = re.sub(r"(\w+ = )\[(-?[\d.]+), (-?[\d.]+)\]", shrink, tail, count=1 if region != 1 else 0) if region != 1 else tail
    path = os.path.join(folder, f"{space}.toml")
    with open(path, "w") as file:
        file.write(head + cameras + tail)
    return path


def bake(space, promise, length, region, folder):
    """Bakes; returns bytes, processor seconds and megabytes of memory."""
    output = os.path.join(folder, "b.fan")
    command = [GEOFAN, "bake", manifold(space, region, folder), "-o", output, "--quiet"]
    command += ["--max-error", str(promise), "--length", str(length), "--certify-rays", "2000"]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    said = child.stderr.read().decode()
    _, status, used = os.wait4(child.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 1):
        sys.exit(f"{' '.join(command)}: {said}")
    return os.path.getsize(output), used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def table(space, axis, values, base, folder):
    """Prints how a bake grows along one axis."""
    print(f"\n| {space}: {axis} | bytes | processor s | memory, MB |\n|---|---|---|---|", flush=True)
    place = ["promise, mrad", "length", "region"].index(axis)
    rows = []
    for value in values:
        arguments = list(base)
        arguments[place] = value
        rows.append(bake(space, *arguments, folder))
        size, seconds, memory = rows[-1]
        print(f"| {value} | {size:,} | {seconds:.2f} | {memory:.0f} |", flush=True)
    span = math.log(values[-1] / values[0])
    size, seconds, memory = (math.log(last / first) / span for first, last in zip(rows[0], rows[-1]))
    print(f"| exponent | {size:.2f} | {seconds:.2f} | {memory:.2f} |", flush=True)


def main():
    """Makes the tables of the spaces that are named, or of all."""
    with tempfile.TemporaryDirectory() as folder:
        for space in sys.argv[1:] or SPACES:
            base, promises, lengths, regions = SPACES[space]
            table(space, "promise, mrad", promises, base, folder)
            table(space, "length", lengths, base, folder)
            if regions:
                table(space, "region", regions, base, folder)


if __name__ == "__main__":
    main()
