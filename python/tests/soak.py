"""Makes a million calls and tells whether memory stays flat.

    python python/tests/soak.py [CALLS]

Ends with exit code 1 if the second half of the calls leaves more than 8 MB behind.
"""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path

import geofan as gf
import numpy as np


def resident():
    """Returns the memory that the process occupies now, MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024


def refused(manifold):
    """Makes a mistake."""
    try:
        manifold.metric_at([np.nan, 0, 0])
    except gf.InputError:
        pass


def main(count):
    sphere = gf.catalogue.s3()
    camera = sphere.camera([0, 0, 0], [1, 0, 0])
    text = sphere.text
    calls = [
        (1, lambda: gf.Manifold(text)),
        (1, lambda: refused(sphere)),
        (2, lambda: camera.turned(right=1.0)),
        (2, lambda: sphere.trace([0.1, 0.2, 0.3], [1, 0, 0], 0.05)),
        (4, lambda: sphere.christoffel([0.1, 0.2, 0.3])),
        (10, lambda: sphere.metric_at([0.1, 0.2, 0.3])),
    ]
    each = [call for times, call in calls for _ in range(times)]
    began, told = time.perf_counter(), []
    for k in range(10):
        for i in range(count // 10):
            each[i % len(each)]()
        gc.collect()
        told.append(resident())
        print(f"{(k + 1) * (count // 10):>9} calls, {time.perf_counter() - began:6.1f} s: {told[-1]:.1f} MB", flush=True)
    return told[-1] - told[4] < 8


if __name__ == "__main__":
    sys.exit(0 if main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000) else 1)
