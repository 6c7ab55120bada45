#!/usr/bin/env python3
"""A reader of bundles, written from docs/FORMAT.md alone.

    read_bundle.py info B.fan                                  what is inside
    read_bundle.py path B.fan --at=A,B,C --dir=X,Y,Z --s=S,…   one path: arc length, point, tangent; its end
    read_bundle.py compare PATHS.json                          all paths of a file of golden ones

`compare` measures in the metric. A path agrees if its points at arc length s are within s/20 of the bundle's
promise, and its tangents within a quarter of it (docs/FORMAT.md, section 11). Exit code 0: all paths agree;
1: some do not; 2: a file is damaged, or has a key that this reader does not evaluate.
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
        """Gives `at` with glued coordinates in their limits and the speed of light restored."""
        state = self.at(s)
        if state is None:
            return None
        u = self.bundle.manifold.wrap(state[0])
        return u, self.bundle.manifold.restored(u, state[1])

    def end(self, length):
        """Finds what ends the path up to this length, and where; None where that is in a flagged piece."""
        known = min([length] + [piece[0][0] for piece in self.pieces if piece[1] is None])
        before = self.values(0.0)
        for i in range(256):
            low, high = known * i / 256, known * (i + 1) / 256
            now = self.values(high)
            met = [k for k, (a, b) in enumerate(zip(before, now)) if b[1] > 0 and b[1] > a[1]]
            if met:
                return min(self.crossing(k, low, high) for k in met)[::-1]
            before = now
        return ("length", length) if known == length else None

    def values(self, s):
        return self.bundle.manifold.ends(*self.at(s))

    def crossing(self, k, low, high):
        """Finds where condition k becomes positive, and its name."""
        for _ in range(60):
            middle = 0.5 * (low + high)
            name, value = self.values(middle)[k]
            low, high = (low, middle) if value > 0 else (middle, high)
        return high, name


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


# By how much geofan's binary32 may move points (times s) and tangents, as shares of the promise; and a start
# (times the size of its numbers), which is exact.
OF_POINTS, OF_TANGENTS, OF_STARTS = 1 / 20, 1 / 4, 1e-12


def promises(bundle):
    """Gives what a bundle promises of points, over s, and of tangents."""
    plan = bundle.plan
    kind, own = plan["tangents"]
    return np.array([plan["max_error"], own if kind == 2 else plan["max_error"]]) / 1000


def deviation(bundle, golden):
    """Finds the largest differences from a golden path in points and tangents, over what is allowed."""
    path = bundle.path(golden["at"], golden["dir"])
    worst = np.zeros(2)
    points, tangents = promises(bundle) * [OF_POINTS, OF_TANGENTS]
    for sample in golden["samples"]:
        s, found = sample["s"], path.sample(sample["s"])
        if found is None:
            return np.array([np.inf, np.inf])
        metric = bundle.manifold.metric(np.array(sample["u"]))
        du, dv = (x - np.array(sample[name]) for x, name in zip(found, "uv"))
        size = lambda x: np.sqrt(x @ metric @ x)
        start = OF_STARTS * (1 + np.linalg.norm(sample["u"]))
        off = [size(du) / (points * s), size(dv) / tangents] if s > 0 else [size(du) / start] * 2
        worst = np.maximum(worst, off)
    return worst


def compare(arguments):
    """Compares all golden paths; returns whether they agree."""
    file = Path(arguments.paths)
    good = True
    for golden in json.loads(file.read_text())["bundles"]:
        bundle = Bundle((file.parent / golden["file"]).read_bytes())
        bundle.decode()
        worst = np.max([deviation(bundle, path) for path in golden["paths"]], axis=0)
        agrees = bool(np.all(worst <= 1))
        good = good and agrees
        print(
            f"{golden['file']:24} {len(golden['paths'])} paths: largest difference {worst[0]:.2f} of "
            f"what is allowed in position, {worst[1]:.2f} in tangent: {'agrees' if agrees else 'DIFFERS'}"
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
        state = found.sample(s)
        known = {"flagged": True} if state is None else {"u": list(state[0]), "v": list(state[1])}
        print(json.dumps({"s": s, **known}))
    end = found.end(min(max(arguments.s), bundle.plan["length"]))
    print(json.dumps({"flagged": True} if end is None else {"end": end[0], "s": end[1]}))
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
    command.set_defaults(run=compare)
    arguments = parser.parse_args()
    try:
        return 0 if arguments.run(arguments) else 1
    except (FormatError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
