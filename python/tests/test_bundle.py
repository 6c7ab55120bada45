"""Tables: baking, checking, lookups, against exact paths and the command line."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import geofan as gf
import numpy as np
import pytest


def test_a_bake_keeps_its_promise_and_says_so(table):
    certificate = table.certificate
    assert certificate.kept and certificate.promise == 1.0 and certificate.rays == 2000
    assert certificate.sky_kept == (certificate.sky_mrad.p99 <= certificate.sky_promise)
    assert certificate.screen_mrad.p50 <= certificate.screen_mrad.p99 <= certificate.screen_mrad.max
    assert "kept" in certificate._repr_html_() and "screen" in certificate._repr_html_()
    assert table.info["reduction"] == "rotation" and "Bump" in table._repr_html_()


def test_the_command_line_checks_and_describes_the_same(command, table):
    told = command("check", table.path, "--rays", 3000, "--seed", 5)
    found = table.check(3000, 5)
    for name in ("mrad", "screen_mrad", "sky_mrad", "rotation_mrad"):
        assert getattr(found, name)._asdict() == told[name], name
    same = ("flagged", "rays", "seed", "promise", "sky_promise", "kept", "sky_kept")
    same += ("beyond_20_promises", "unfinished", "worst")
    assert {name: getattr(found, name) for name in same} == {name: told[name] for name in same}
    assert found.kept and len(table.to_bytes()) == told["bytes"]
    info = command("info", table.path)
    mine = table.info
    assert {key: mine[key] for key in mine} == {key: info[key] for key in mine}


def test_a_bake_is_that_of_the_command_line(command, bump, table, tmp_path):
    (tmp_path / "bump.toml").write_text(bump.text)
    command("bake", tmp_path / "bump.toml", "-o", tmp_path / "b.fan", "--max-error", 1, "--certify-rays", 2000)
    mine, theirs = table.info, gf.Bundle(tmp_path / "b.fan").info
    # The id depends on manifold and plan; the source is the name of the text.
    for key in mine.keys() - {"manifold"}:
        assert mine[key] == theirs[key], key


def test_directions_have_a_promise_of_their_own(command, bump, tmp_path):
    (tmp_path / "bump.toml").write_text(bump.text)
    line = ("--max-error", 2, "--max-sky-error", 9, "--certify-rays", 500)
    told = command("bake", tmp_path / "bump.toml", "-o", tmp_path / "b.fan", *line)
    mine = bump.bake(2.0, max_sky_error=9.0, certify_rays=500)
    assert mine.certificate.sky_promise == told["sky_promise"] == 9.0
    assert len(mine.to_bytes()) < len(bump.bake(2.0, certify_rays=500).to_bytes())
    with pytest.raises(gf.InputError, match="directions"):
        bump.bake(2.0, max_sky_error=9.0, frames=False)


def test_a_table_without_frames_has_none(bump):
    table = bump.bake(2.0, frames=False, certify_rays=500)
    assert table.trace([3.0, 0, 0], [-1, 0.2, 0]).frame is None
    assert table.certificate.sky_kept is None


def test_shares_of_a_bake_are_joined_to_the_same_bytes(bump, table, tmp_path):
    shares = [bump.bake_share((i, 3), tmp_path / f"{i}.fan", 1.0, certify_rays=2000) for i in (1, 2, 3)]
    whole = gf.Bundle.merge(shares[::-1], tmp_path / "whole.fan")
    assert whole.to_bytes() == table.to_bytes()
    with pytest.raises(gf.InputError):
        gf.Bundle.merge(shares[:2], tmp_path / "part.fan")
    with pytest.raises(gf.InputError, match="numbered"):
        bump.bake_share((4, 3), tmp_path / "4.fan")


def test_paths_that_end_before_they_leave_are_warned_of(bump):
    with pytest.warns(gf.GeofanWarning, match="greater `length`"):
        bump.bake(5.0, length=3.0, certify_rays=500)


def test_looked_up_paths_are_within_the_promise(bump, table, random):
    camera, s = [2.1, 0.7, -0.4], np.linspace(0, 4, 5)
    directions = random.normal(size=(20, 30, 3))
    found = table.paths(camera, directions, s)
    exact = bump.trace(camera, directions, s=s, length=10.0)
    assert found.u.shape == (20, 30, 5, 3) and found.flagged.shape == (20, 30)
    inside = np.isfinite(exact.u)
    off = np.linalg.norm(np.where(inside, found.u - exact.u, 0), axis=-1)
    assert np.quantile(off[..., 1:] / s[1:], 0.99) < 2e-3
    np.testing.assert_allclose(found.u[..., 0, :], np.broadcast_to(camera, (20, 30, 3)), atol=1e-12)


def test_traced_paths_are_those_of_the_command_line(command, table, random):
    at = [2.1, 0.7, -0.4]
    directions = random.normal(size=(3, 3))
    paths = table.trace(at, directions, samples=4)
    for i, d in enumerate(directions):
        told = command(
            "trace", "--bundle", table.path, "--at", ",".join(map(str, at)),
            f"--dir={','.join(map(repr, d.tolist()))}", "--samples", 4,
        )  # fmt: skip
        for name in ("s", "u", "v", "frame"):
            np.testing.assert_array_equal(getattr(paths, name)[i], [x[name] for x in told["samples"]])
        assert paths.end[i] == told["end"] and paths.area is None


def test_skies_are_those_of_exact_paths(bump, table, random):
    camera, directions = [1.5, 0.2, 0.1], random.normal(size=(100, 3))
    found = table.sky(camera, directions)
    exact = bump.trace(camera, directions, tolerance=1e-11)
    assert set(found.end) == {"sky"} == set(exact.end)
    np.testing.assert_allclose(found.length, exact.length, atol=2e-2)
    # Outside of the bump the ambient direction is the chart's.
    chart = exact.v[:, -1] / np.linalg.norm(exact.v[:, -1], axis=-1, keepdims=True)
    np.testing.assert_allclose(found.direction, chart, atol=5e-3)


def test_bundles_are_pickled_saved_and_read(table, tmp_path):
    again = pickle.loads(pickle.dumps(table))
    camera, s = [1.0, 0.5, 0.2], [0.0, 1.0, 2.0]
    directions = np.eye(3)
    np.testing.assert_array_equal(again.paths(camera, directions, s).u, table.paths(camera, directions, s).u)
    assert again.path is None and again.save(tmp_path / "again.fan") == os.path.getsize(tmp_path / "again.fan")
    assert (tmp_path / "again.fan").read_bytes() == table.path.read_bytes() == again.to_bytes()


@pytest.mark.parametrize(
    "call",
    [
        lambda b: b.paths([99, 0, 0], np.eye(3), [1.0]),
        lambda b: b.paths([1, 0, 0], np.eye(3), [99.0]),
        lambda b: b.paths([1, 0, 0], np.zeros((2, 3)), [1.0]),
        lambda b: b.paths([1, 0, 0], np.eye(3), [2.0, 1.0]),
        lambda b: b.paths([1, 0, np.nan], np.eye(3), [1.0]),
        lambda b: b.paths([1, 0], np.eye(3), [1.0]),
        lambda b: b.sky([99, 0, 0], np.eye(3)),
        lambda b: b.sky([1, 0, 0], [np.nan, 0, 0]),
        lambda b: b.trace([99, 0, 0], np.eye(3)),
        lambda b: b.trace([1, 0, 0], np.eye(3), 99.0),
        lambda b: b.check(0),
        lambda b: b.check(10, -1),
        lambda b: b.save("/there/is/no/such/folder/b.fan"),
    ],
)
def test_bad_arguments_raise_an_input_error(table, call):
    with pytest.raises((gf.InputError, OSError)):
        call(table)


def test_every_damage_of_a_bundle_is_found(table, random):
    data = table.to_bytes()
    for cut in random.integers(0, len(data), 20):
        with pytest.raises(gf.InputError):
            gf.Bundle.from_bytes(data[:cut])
    for at in random.integers(0, len(data), 40):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(random.integers(8))
        with pytest.raises(gf.InputError):
            gf.Bundle.from_bytes(bytes(damaged))


def test_progress_is_told_and_may_end_the_work(bump):
    told = []
    bump.bake(2.0, certify_rays=500, progress=lambda *news: told.append(news))
    assert told and all(done <= total for _, done, total, _ in told if total)

    def stop(*news):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        bump.bake(0.01, certify_rays=500, progress=stop)


INTERRUPTED = """
    import sys, geofan as gf
    bump = gf.Manifold(sys.argv[1])
    def told(work, done, total, detail):
        if work != "planning" and done:
            print("working", flush=True)
    try:
        bump.bake(0.02, out=sys.argv[2], certify_rays=500, resume=len(sys.argv) > 3, progress=told)
    except KeyboardInterrupt as error:
        print("interrupted", *getattr(error, "__notes__", []), flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_a_bake_and_it_goes_on_where_it_was(tmp_path):
    lens = gf.Manifold.metric(
        conformal="exp(0.5*exp(-(x^2 + y^2 + z^2)/2))",
        cameras={"parameters": {"a": (-1, 1), "b": (-1, 1)}, "at": ["a", "b", 0.3]},
        length=4.0,
    )
    path, out = tmp_path / "lens.toml", tmp_path / "lens.fan"
    path.write_text(lens.text)
    line = [sys.executable, "-c", textwrap.dedent(INTERRUPTED), str(path), str(out)]
    child = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None and "working" in child.stdout.readline()
    child.send_signal(signal.SIGINT)
    rest = child.stdout.read()
    assert child.wait() == 0 and "interrupted" in rest and "what is finished is in" in rest
    assert not out.exists() and Path(f"{out}.parts").is_dir()
    # The same bake in one go has the same bytes.
    subprocess.run([*line, "resume"], check=True, stdout=subprocess.DEVNULL)
    whole = gf.Manifold(path).bake(0.02, out=tmp_path / "whole.fan", certify_rays=500)
    assert out.read_bytes() == whole.path.read_bytes() and not Path(f"{out}.parts").exists()
