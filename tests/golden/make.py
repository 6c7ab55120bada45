#!/usr/bin/env python3
"""Makes the golden bundles and the values of their paths.

    make.py [--bundles] [--target DIR]

Without `--bundles` only paths.json is written, from the bundles as they are: that is what a change of
evaluation needs. With it the bundles are baked first, as the rows of docs/accuracy.sh are: after a change of the
format. DIR holds the programs (default: target/release beside this repository's sources).
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent

# Bundle, promise (mrad), length; its manifold file stands beside it.
BUNDLES = [("nil", 0.05, 5.0), ("s3", 0.05, 3.0), ("three-bumps-rail", 0.5, 8.0)]

# Ten cameras and directions of each, off every plane of symmetry, over all faces of directions.
DIRECTIONS = [
    [0.82, -0.31, 0.47],
    [-0.77, 0.23, 0.36],
    [0.19, 0.91, -0.28],
    [-0.33, -0.85, 0.41],
    [0.27, 0.38, 0.88],
    [-0.42, 0.17, -0.81],
    [0.61, 0.53, 0.58],
    [-0.59, -0.49, -0.64],
    [0.11, -0.72, -0.69],
    [0.97, 0.08, -0.13],
]
CAMERAS = {
    "nil": [
        [0.31, -0.72, 0.45],
        [-1.37, 0.64, 2.11],
        [1.05, 0.48, -0.93],
        [0.0, 0.0, 0.0],
        [-0.58, -1.13, -0.72],
        [1.21, -0.37, 0.86],
        [-1.44, 1.09, 0.28],
        [0.73, 1.31, -1.15],
        [-0.16, 0.94, -1.62],
        [0.84, -1.57, 1.33],
    ],
    "s3": [
        [0.31, -0.72, 0.45],
        [-0.24, 0.17, 0.38],
        [0.92, 0.61, -0.53],
        [0.04, -0.07, 0.02],
        [-0.58, -0.83, -0.71],
        [0.47, -0.37, 0.26],
        [-1.02, 0.69, 0.28],
        [0.13, 0.21, -1.15],
        [-0.16, 0.94, -0.62],
        [0.84, -0.57, 0.33],
    ],
    "three-bumps-rail": [
        [c, 0.3, 0.2] for c in (-1.93, -1.41, -0.87, -0.46, -0.12, 0.29, 0.71, 1.13, 1.58, 1.97)
    ],
}
# Lengths of the paths: those of the bumps end where they leave the sphere of radius 5.
LENGTHS = {
    "nil": [5.0] * 10,
    "s3": [3.0] * 10,
    "three-bumps-rail": [7.5, 3.7, 5.5, 5.3, 5.2, 5.7, 4.7, 6.5, 5.9, 3.1],
}
SAMPLES = 6


def run(target, program, *arguments):
    """Runs a program and gives what it prints as JSON."""
    command = [str(target / program), *map(str, arguments), "--quiet", "--json"]
    found = subprocess.run(command, cwd=HERE, stdout=subprocess.PIPE, check=True)
    return json.loads(found.stdout)


def comma(vector):
    return ",".join(map(repr, vector))


def bake(target, name, promise, length):
    options = ["--max-error", promise, "--length", length]
    run(target, "geofan-bake", f"{name}.toml", "-o", f"{name}.fan", *options)


def paths(target, name):
    """Traces the golden paths of a bundle."""
    found = []
    for k, (at, dir, length) in enumerate(zip(CAMERAS[name], DIRECTIONS, LENGTHS[name])):
        where = [f"--at={comma(at)}", f"--dir={comma(dir)}", "--length", length, "--samples", SAMPLES]
        trace = run(target, "geofan", "trace", "--bundle", f"{name}.fan", *where)
        if trace["end"] != "length" or trace.get("exact"):
            sys.exit(f"{name}, path {k}: ends at {trace['end']}; choose another")
        samples = [{key: sample[key] for key in "suv"} for sample in trace["samples"]]
        found.append({"at": at, "dir": dir, "samples": samples})
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--bundles", action="store_true", help="bake the bundles first")
    parser.add_argument("--target", type=Path, default=HERE.parents[1] / "target" / "release")
    arguments = parser.parse_args()
    target, bundles = arguments.target.resolve(), []
    for name, promise, length in BUNDLES:
        if arguments.bundles:
            bake(target, name, promise, length)
        bundles.append({"file": f"{name}.fan", "paths": paths(target, name)})
    text = json.dumps({"bundles": bundles}, indent=1)
    (HERE / "paths.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
