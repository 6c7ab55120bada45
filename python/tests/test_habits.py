"""Memory, types, and the documents."""

import gc
import resource
import subprocess
import sys
from pathlib import Path

import geofan as gf
import numpy as np
import pytest

PACKAGE = Path(gf.__file__).parent


def resident_bytes():
    """Returns the memory that the process occupies now."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return 1024 * int(line.split()[1])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize(
    "call",
    [
        lambda m: m.christoffel([0.1, 0.2, 0.3]),
        lambda m: m.trace([0.1, 0.2, 0.3], [1, 0, 0], 0.1),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).moved(forward=0.01),
        lambda m: pytest.raises(gf.InputError, m.metric_at, [np.nan, 0, 0]),
    ],
)
def test_calls_leave_nothing_behind(call, s3):
    def many(count):
        for _ in range(count):
            call(s3)
        gc.collect()

    many(2000)
    before = resident_bytes()
    many(4000)
    # Two pages a call would be 32 MB.
    assert resident_bytes() - before < 4e6


def test_results_are_written_where_they_are_read(s3, random):
    directions = random.normal(size=(20_000, 3))
    tracemalloc = pytest.importorskip("tracemalloc")
    tracemalloc.start()
    paths = s3.trace([0.1, 0.2, 0.3], directions, 1.0, samples=20)
    current, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    arrays = [getattr(paths, name) for name in ("s", "u", "v", "frame", "area", "length", "steps", "end_number")]
    result = sum(array.nbytes for array in arrays)
    assert result > 50e6 and result <= peak < 1.01 * result + 1e5
    assert all(array.base is None or array.base.base is None for array in arrays)


PEAK = """
import sys, geofan as gf, numpy as np

def peak():
    return 1024 * int(next(x for x in open("/proc/self/status") if x.startswith("VmHWM")).split()[1])

table = gf.Bundle(sys.argv[1])
space = table.manifold
directions = np.random.default_rng(1).normal(size=(200_000, 3))
s = np.linspace(0, 4, 20)
calls = {
    "exact": lambda n, s: space.trace([2.1, 0.7, -0.4], directions[:n], s=s, length=10.0),
    "table": lambda n, s: table.paths([2.1, 0.7, -0.4], directions[:n], s),
    "paths": lambda n, s: table.trace([2.1, 0.7, -0.4], directions[: n // 4], samples=len(s)),
}
call = calls[sys.argv[2]]
call(9000, s)
before = peak()
found = call(len(directions), s)
size = sum(x.nbytes for x in vars(found).values() if isinstance(x, np.ndarray))
print(size, peak() - before)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc")
@pytest.mark.parametrize("call", ["exact", "table", "paths"])
def test_a_result_is_all_the_memory_that_a_call_takes(call, table):
    line = [sys.executable, "-c", PEAK, str(table.path), call]
    size, grown = map(int, subprocess.run(line, check=True, capture_output=True, text=True).stdout.split())
    # Besides the result there are the blocks that the threads are at, and one byte or two of each ray.
    assert size > 1e8 and grown < 1.03 * size + 1.5e7


@pytest.mark.parametrize("arguments", [["mypy", "--strict", "-p", "geofan"], ["mypy.stubtest", "geofan", "--mypy-config-file", "pyproject.toml", "--allowlist", "tests/stubtest-allowlist.txt"]])
def test_types_are_right(arguments, tmp_path):
    pytest.importorskip("mypy")
    line = [sys.executable, "-m", *arguments]
    done = subprocess.run(line, capture_output=True, text=True, cwd=PACKAGE.parent, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_examples_in_docstrings_hold():
    import doctest

    for name in ("", "._manifold", "._threads", ".catalogue", "._scene"):
        module = sys.modules[f"geofan{name}"]
        result = doctest.testmod(module)
        assert result.failed == 0


def test_everything_public_has_a_docstring():
    for name in gf.__all__:
        item = getattr(gf, name)
        if isinstance(item, type):
            for key, member in vars(item).items():
                if not key.startswith("_") and (callable(member) or isinstance(member, (property, classmethod))):
                    assert member.__doc__, f"{name}.{key}"
        if name != "__version__":
            assert item.__doc__, name
