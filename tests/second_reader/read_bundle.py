#!/usr/bin/env python3
"""A reader of bundles, written from docs/FORMAT.md alone.

    read_bundle.py info B.fan                        what is inside
    read_bundle.py path B.fan --at=A,B,C --dir=X,Y,Z --s=S,…   one path: arc length, point, tangent
    read_bundle.py compare PATHS.json [--tolerance T]          all paths of a file of golden ones

The exit code of `compare` is 0 if all paths agree within the tolerance, else 1.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from container import FormatError, read_container, require
from manifold import Manifold
from patches import Shape, pieces, read_chunk
from rays import ChartMap, RaySpace


def integrated(slopes, interval, start):
    """Integrates the coefficients of a slope to those of the departure from `start`: section 9.3."""
    low, high = interval
    count, channels = slopes.shape
    a = np.vstack([slopes, np.zeros((2, channels))])
    b = np.zeros((count + 1, channels))
    half = 0.5 * (high - low)
    for k in range(1, count + 1):
        b[k] = half * ((2 if k == 1 else 1) * a[k - 1] - a[k + 1]) / (2 * k)
    signs = np.array([(-1.0) ** k for k in range(1, count + 1)])
    b[0] = low * start - signs @ b[1:]
    return b


class TablePath:
    """One path of a bundle."""

    def __init__(self, bundle, u, d):
        self.bundle = bundle
        ray = bundle.space.locate(np.asarray(u, dtype=float), np.asarray(d, dtype=float))
        self.isometry = ray.isometry
        self.start = bundle.chart_map.lift(ray.u, ray.v)
        face = (ray.face, ray.direction)
        together = bundle.space.axes is not None
        directions = bundle.space.spherical(ray.aim) if together else ray.direction
        tree = bundle.tree(ray.chunk)
        interval = (0.0, bundle.plan["length"])
        self.pieces = [
            (own, None if rows is None else self.unfolded(rows, own))
            for own, rows in pieces(tree, ray.cameras, directions, face, interval)
        ]

    @staticmethod
    def unfolded(rows, interval):
        """Gives the coefficients of departure and slope."""
        stored_start = interval[0] > 0
        start = rows[0] if stored_start else np.zeros(rows.shape[1])
        slopes = rows[int(stored_start) :]
        return integrated(slopes, interval, start), slopes

    def at(self, s):
        """Gives chart point and tangent at arc length s; None where flagged."""
        own = [piece for piece in self.pieces if s <= piece[0][1]] or self.pieces[-1:]
        (low, high), coefficients = own[0]
        if coefficients is None:
            return None
        t = 2 * (s - low) / (high - low) - 1
        sums = np.zeros((2, 4))
        for sum, c in zip(sums, coefficients):
            if len(c):
                sum[self.bundle.chart_map.channels] = np.polynomial.chebyshev.chebval(t, c)
        x, slope = self.start
        stored = self.bundle.chart_map.project(x + s * slope + sums[0], slope + sums[1])
        u, differential = self.isometry(stored[0])
        return u, differential @ stored[1]

    def sample(self, s):
        """Gives `at` with glued coordinates in their limits and a tangent of unit length."""
        u, v = self.at(s)
        u = self.bundle.manifold.wrap(u)
        return u, v / np.sqrt(v @ self.bundle.manifold.metric(u) @ v)


class Bundle:
    """A bundle in memory; chunks are decoded when they are first used."""

    def __init__(self, data):
        container = read_container(data)
        self.header, self.id, self.payloads = container.header, container.id, container.chunks
        self.plan = self.header["plan"]
        record = self.header["manifold"]
        self.manifold = Manifold(record["text"], record["parameters"])
        self.space = RaySpace(self.header, self.manifold)
        planar = self.header["reduction"] == "rotation"
        self.chart_map = ChartMap(*self.plan["chart_map"], planar)
        if self.header["shard"] is None:
            require(list(self.payloads) == list(range(self.space.chunks)), "chunks are missing")
        self.trees = {}

    def tree(self, chunk):
        if chunk not in self.trees:
            shape = Shape(
                cameras=len(self.header["cameras"]),
                directions=1 if self.header["reduction"] == "rotation" else 2,
                channels=len(self.chart_map.channels),
                alpha=self.plan["alpha"],
                sphere=self.space.axes is not None,
            )
            self.trees[chunk] = read_chunk(self.payloads[chunk], shape)
        return self.trees[chunk]

    def decode(self):
        """Decodes all chunks."""
        for chunk in self.payloads:
            self.tree(chunk)

    def path(self, u, d):
        """Reads the path of the camera at u in the direction d (standard frame, of any length)."""
        d = np.asarray(d, dtype=float)
        return TablePath(self, u, d / np.linalg.norm(d))


def deviation(bundle, golden):
    """Finds the largest differences from a golden path, in position and tangent."""
    path = bundle.path(golden["at"], golden["dir"])
    worst = np.zeros(2)
    for sample in golden["samples"]:
        found = path.sample(sample["s"])
        for k, name in enumerate("uv"):
            worst[k] = max(worst[k], np.abs(found[k] - np.array(sample[name])).max())
    return worst


def compare(arguments):
    """Compares all golden paths; returns whether they agree."""
    file = Path(arguments.paths)
    good = True
    for golden in json.loads(file.read_text())["bundles"]:
        bundle = Bundle((file.parent / golden["file"]).read_bytes())
        bundle.decode()
        worst = np.max([deviation(bundle, path) for path in golden["paths"]], axis=0)
        agrees = bool(np.all(worst <= arguments.tolerance))
        good = good and agrees
        verdict = "agrees" if agrees else "DIFFERS"
        print(
            f"{golden['file']:24} {len(golden['paths'])} paths: largest difference "
            f"{worst[0]:.2e} in position, {worst[1]:.2e} in tangent: {verdict}"
        )
    return good


def info(arguments):
    bundle = Bundle(Path(arguments.bundle).read_bytes())
    header = {k: v for k, v in bundle.header.items() if k != "manifold"}
    print(json.dumps({"id": bundle.id.hex(), "chunks": len(bundle.payloads), **header}, indent=1))
    return True


def path(arguments):
    bundle = Bundle(Path(arguments.bundle).read_bytes())
    found = bundle.path(arguments.at, arguments.dir)
    for s in arguments.s:
        u, v = found.sample(s)
        print(json.dumps({"s": s, "u": list(u), "v": list(v)}))
    return True


def numbers(text):
    return [float(x) for x in text.split(",")]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("info")
    command.add_argument("bundle")
    command.set_defaults(run=info)
    command = commands.add_parser("path")
    command.add_argument("bundle")
    for name in ("--at", "--dir", "--s"):
        command.add_argument(name, type=numbers, required=True)
    command.set_defaults(run=path)
    command = commands.add_parser("compare")
    command.add_argument("paths")
    command.add_argument("--tolerance", type=float, default=1e-9)
    command.set_defaults(run=compare)
    arguments = parser.parse_args()
    try:
        return 0 if arguments.run(arguments) else 1
    except (FormatError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
