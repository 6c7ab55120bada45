"""Long work: Ctrl-C, progress, several threads of Python, and results that no memory holds."""

import copy
import os
import signal
import subprocess
import sys
import threading
import time

import geofan as gf
import numpy as np
import pytest
from conftest import SCENES

SIDE_BY_SIDE = """
import threading, geofan as gf
hole = gf.catalogue.schwarzschild()
camera = hole.camera([9, 0, 0], [-1, 0, 0])
scene = gf.Scene(hole, sky="grid")

def draw():
    for _ in range(10):
        scene.render(camera=camera, size=(64, 36))

threads = [threading.Thread(target=draw) for _ in range(3)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


@pytest.fixture(scope="module")
def hole():
    return gf.catalogue.schwarzschild()


@pytest.fixture(scope="module")
def lamp_lit():
    return gf.Scene(SCENES / "s3-lamp.toml")


def test_threads_of_python_draw_one_scene():
    subprocess.run([sys.executable, "-c", SIDE_BY_SIDE], check=True, timeout=300)


def long_picture(hole, **options):
    camera = hole.camera([9, 0, 0], [-1, 0, 0])
    return gf.Scene(hole, sky="grid").render(camera=camera, size=(3000, 2000), **options)


def many_rays(hole):
    directions = np.random.default_rng(1).normal(size=(4000, 3))
    return hole.trace([9, 0, 0], directions, 1e4, samples=1000, tolerance=1e-13, conjugate=True)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize(
    "call",
    [
        long_picture,
        lambda m: long_picture(m, tracer="path", spp=100),
        lambda m: m.scalar_curvature(np.broadcast_to([9.0, 1, 0], (5_000_000, 3))),
        many_rays,
    ],
)
def test_ctrl_c_ends_long_work(call, hole):
    ends = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    ends.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        call(hole)
    # Each takes far longer as a whole.
    assert time.monotonic() - began < 5


def test_pictures_tell_their_progress(bump, table):
    camera = bump.camera({"c": 3.0}, [-1, 0, 0])
    scene = gf.Scene(bump, sky="grid")
    for options in ({}, {"bundle": table}, {"spp": 20}, {"crop": (3, 5, 20, 11)}):
        told = []
        scene.render(camera=camera, size=(64, 36), progress=lambda *news: told.append(news), **options)
        pixels = 20 * 11 if "crop" in options else 64 * 36
        samples = pixels * options.get("spp", 1)
        assert told[-1] == ("picture", samples, samples, "") and told.count(told[-1]) == 1


def test_the_light_of_lamps_is_told(lamp_lit):
    told = []
    lamp_lit.render(size=(16, 9), progress=lambda *news: told.append(news))
    assert {work for work, *_ in told} == {"light", "picture"}
    assert all(done <= total for _, done, total, _ in told)


def test_a_scene_whose_light_was_given_up_is_lit_again():
    scene = gf.Scene(SCENES / "s3-lamp.toml")

    def stop(work, done, total, detail):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        scene.render(size=(16, 9), progress=stop)
    expected = gf.Scene(SCENES / "s3-lamp.toml").render(size=(16, 9))
    np.testing.assert_array_equal(scene.render(size=(16, 9)).rgb, expected.rgb)


def test_a_scene_tells_about_itself_while_it_is_drawn(hole):
    scene = gf.Scene(SCENES / "wormhole-gallery.toml")
    drawing = threading.Thread(target=lambda: scene.render(size=(900, 600)))
    drawing.start()
    time.sleep(0.1)
    began, counted = time.monotonic(), 0
    assert scene.text and (scene.views, scene.warnings, scene.camera()) is not None
    assert drawing.is_alive() and time.monotonic() - began < 0.5
    # While one thread waits for the picture, others go on.
    waiting = threading.Thread(target=lambda: scene.render(size=(16, 9)))
    waiting.start()
    while drawing.is_alive():
        counted += 1
        time.sleep(0.001)
    drawing.join()
    waiting.join()
    assert counted > 20


@pytest.mark.parametrize(
    "call",
    [
        lambda m, c, b: c.directions((2000, 2000)),
        lambda m, c, b: m.riemann(np.broadcast_to([1.0, 0, 0], (10**6, 3))),
        lambda m, c, b: m.trace([1, 0, 0], np.broadcast_to([1.0, 0, 0], (1000, 3)), 1.0, samples=10_000),
        lambda m, c, b: m.connect([1, 0, 0], np.broadcast_to([0.5, 0, 0], (10**7, 3)), 1.0),
        lambda m, c, b: b.sky([1, 0, 0], np.broadcast_to([1.0, 0, 0], (10**7, 3))),
        lambda m, c, b: b.paths([1, 0, 0], np.broadcast_to([1.0, 0, 0], (10**6, 3)), np.linspace(0, 1, 50)),
        lambda m, c, b: gf.Scene(m, sky="grid").render(camera=c, size=(4096, 4096)),
        lambda m, c, b: gf.Scene(m, sky="grid").render(camera=c, size=(4096, 4096), tracer="path"),
        lambda m, c, b: gf.Scene(m, sky="grid").compare(camera=c, size=(2048, 2048)),
    ],
)
def test_results_that_no_memory_holds_are_refused(call, bump, table, monkeypatch):
    monkeypatch.setattr("geofan._memory.most_bytes", lambda: 80_000_000)
    camera = bump.camera({"c": 3.0}, [-1, 0, 0])
    with pytest.raises(gf.InputError, match="GB"):
        call(bump, camera, table)


def test_sizes_beyond_counting_are_refused(bump):
    camera = bump.camera({"c": 3.0}, [-1, 0, 0])
    for call in (
        lambda: bump.riemann(np.broadcast_to([1.0, 0, 0], (2 * 10**10, 3))),
        lambda: camera.directions((2**40, 2**40)),
        lambda: camera.directions((10**6, 10**6)),
        lambda: bump.trace([1, 0, 0], np.broadcast_to([1.0, 0, 0], (10**12, 3)), 1.0, samples=10_000_000),
    ):
        with pytest.raises(gf.InputError):
            call()


LITTLE_MEMORY = """
import resource, geofan as gf, numpy as np
flat = gf.catalogue.flat()
flat.riemann([0, 0, 0])
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (taken + 500_000_000, resource.RLIM_INFINITY))
assert gf._memory.most_bytes() < 500_000_000
gf._memory.most_bytes = lambda: 1 << 40
try:
    flat.riemann(np.broadcast_to([0.0, 0, 0], (2_000_000, 3)))
except MemoryError:
    print("refused")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory")
def test_memory_that_is_not_given_is_an_exception():
    line = [sys.executable, "-c", "import geofan._memory\n" + LITTLE_MEMORY]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.stdout == "refused\n", done.stderr


def test_a_copy_of_a_scene_changes_alone():
    scene = gf.Scene(gf.catalogue.flat(), sky="grid").light([0, 0, 1])
    text = scene.text
    copy.copy(scene).light([0, 0, 2]).sky({"length": (1, 1, 1)}).add((np.eye(3), [[0, 1, 2]]), at=[1, 0, 0])
    assert scene.text == text
