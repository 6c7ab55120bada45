"""Exact paths against independent integration, closed forms and the command line."""

import geofan as gf
import numpy as np
import pytest
from conftest import MANIFOLDS


def geodesic_by_scipy(manifold, at, v, s):
    """Follows a geodesic by scipy, from Christoffel symbols alone."""
    solve_ivp = pytest.importorskip("scipy.integrate").solve_ivp

    def rate(_, y):
        gamma = manifold.christoffel(y[:3])
        return np.concatenate([y[3:], -np.einsum("kij,i,j->k", gamma, y[3:], y[3:])])

    start = np.concatenate([at, v])
    return solve_ivp(rate, (0, s[-1]), start, "DOP853", t_eval=s, rtol=1e-12, atol=1e-12).y.T


@pytest.mark.parametrize(
    ("name", "at", "direction", "length"),
    [
        ("schwarzschild", (9.0, 0.5, -0.3), (-1.0, 0.7, 0.2), 15.0),
        ("ellis-wormhole", (3.0, 0.4, 0.2), (-1.0, 0.1, 0.3), 9.0),
        ("nil", (0.3, -0.2, 0.5), (0.5, 0.3, 0.8), 6.0),
        ("sol", (0.1, 0.2, 0.3), (0.6, 0.5, 0.62), 3.0),
        ("gaussian-bump", (2.0, 0.4, 0.3), (-1.0, 0.1, -0.2), 5.0),
    ],
)
def test_scipy_finds_the_same_geodesics(name, at, direction, length):
    manifold = gf.Manifold(MANIFOLDS / f"{name}.toml")
    s = np.linspace(0, length, 7)
    paths = manifold.trace(at, direction, length, s=s, tolerance=1e-12)
    assert paths.length == length
    truth = geodesic_by_scipy(manifold, at, paths.v[0], s)
    np.testing.assert_allclose(paths.u, truth[:, :3], atol=1e-8)
    np.testing.assert_allclose(paths.v, truth[:, 3:], atol=1e-8)


def test_rays_of_the_three_sphere_meet_at_the_antipode(s3, random):
    at = np.array([0.5, 0.0, 0.0])
    s = [0.5, 1.0, 2.0, 3.0, np.pi]
    paths = s3.trace(at, random.normal(size=(3, 50, 3)), 4.0, s=s, conjugate=True)
    assert paths.u.shape == (3, 50, 5, 3) and paths.frame.shape == (3, 50, 5, 3, 3)
    np.testing.assert_allclose(paths.u[..., -1, :], np.broadcast_to(-at / (at @ at), (3, 50, 3)), atol=1e-7)
    np.testing.assert_allclose(paths.area, np.broadcast_to(np.sin(s) ** 2, (3, 50, 5)), atol=1e-8)
    # Twofold there.
    assert all(np.allclose(points, np.pi) and len(points) > 0 for points in paths.conjugate)
    bare = s3.trace(at, [1, 0.3, 0.2], 4.0, s=s, frame=False, conjugate=True)
    assert bare.frame is None and all(np.allclose(points, np.pi) for points in bare.conjugate)
    assert all(len(points) > 0 for points in bare.conjugate)


@pytest.mark.parametrize("name", ["schwarzschild", "ellis-wormhole", "flat-torus", "three-bumps"])
def test_the_command_line_tells_the_same_paths(command, name, random):
    path = MANIFOLDS / f"{name}.toml"
    manifold = gf.Manifold(path)
    at = np.array([4.0, 0.3, 0.1]) if name != "flat-torus" else np.array([0.2, 0.3, 0.1])
    directions = random.normal(size=(4, 3))
    paths = manifold.trace(at, directions, 7.0, samples=5, conjugate=True)
    for i, d in enumerate(directions):
        told = command(
            "trace", path, "--at", ",".join(map(str, at)), f"--dir={','.join(map(repr, d.tolist()))}",
            "--length", 7, "--samples", 5,
        )  # fmt: skip
        samples = told["samples"]
        for name in ("s", "u", "v", "frame", "area"):
            np.testing.assert_array_equal(getattr(paths, name)[i], [x[name] for x in samples])
        assert paths.end[i] == told["end"] and paths.steps[i] == told["steps"]
        np.testing.assert_array_equal(paths.conjugate[i], told["conjugate"])


def test_paths_know_their_ends_and_have_no_numbers_beyond():
    hole = gf.catalogue.schwarzschild()
    paths = hole.trace([9.0, 0, 0], [[-1, 0.1, 0], [-1, 0.9, 0]], s=[0, 5, 30], length=80)
    assert list(paths.end) == ["horizon", "sky"] and paths.ends[-2:] == ("length", "singular")
    assert np.isnan(paths.u[0, 2]).all() and np.isfinite(paths.u[1, 2]).all()
    assert 5 < paths.length[0] < 30


def test_a_single_ray_has_no_axis_of_rays_and_arrays_are_broadcast(s3, random):
    assert s3.trace([0, 0, 0], [1, 0, 0], 1.0).u.shape == (2, 3)
    at, direction = random.uniform(-1, 1, (4, 1, 3)), random.normal(size=(5, 3))
    both = s3.trace(at, direction, 1.0)
    assert both.u.shape == (4, 5, 2, 3) and both.end.shape == (4, 5)
    one = s3.trace(at[2, 0], direction[3], 1.0)
    np.testing.assert_array_equal(both.u[2, 3], one.u)
    assert s3.trace(np.zeros((0, 3)), [1, 0, 0], 1.0).u.shape == (0, 2, 3)


def test_what_is_not_wanted_is_not_there(s3):
    bare = s3.trace([0, 0, 0], [1, 0, 0], 1.0, frame=False, area=False)
    assert bare.frame is None and bare.area is None and bare.g is None and bare.t is None


def test_no_paths_have_what_paths_would_have(s3):
    none = s3.trace(np.zeros((0, 3)), [1, 0, 0], 1.0, frame=False, area=False)
    assert none.frame is None and none.area is None and none.g is None and none.u.shape == (0, 2, 3)
    assert s3.trace(np.zeros((0, 3)), [1, 0, 0], 1.0).frame.shape == (0, 2, 3, 3)


def test_columns_keep_names_apart():
    odd = gf.Manifold.metric(conformal=1, coordinates=["s", "q", "t"])
    columns = odd.trace([1, 2, 3], [1, 0, 0], 1.0).columns()
    assert list(columns) == ["ray", "s", "u_s", "u_q", "u_t", "v_s", "v_q", "v_t", "area"]
    assert columns["s"].tolist() == [0, 1] and columns["u_s"].round(9).tolist() == [1, 2]


def test_whole_numbers_may_be_floats_and_paths_go_to_the_last_sample(s3):
    assert s3.trace([0, 0, 0], [1, 0, 0], 1.0, samples=3.0).u.shape == (3, 3)
    assert s3.length != 0.5 and s3.trace([0, 0, 0], [1, 0, 0], s=[0, 0.5]).length == 0.5


def test_many_points_are_connected_as_each_alone(s3, random):
    p, q = [0.3, 0.1, 0.0], random.uniform(-1, 1, (1500, 3))
    found = s3.connect(p, q, 5.0)
    assert (np.diff(found.index) >= 0).all() and found.index[-1] == 1499
    for i in (3, 1023, 1024, 1499):
        alone = s3.connect(p, q[i], 5.0)
        np.testing.assert_allclose(found.length[found.index == i], alone.length, rtol=1e-7)


def test_all_geodesics_between_two_points_of_the_three_sphere(s3):
    p, q = np.array([0.3, 0.1, 0.0]), np.array([-0.2, 0.6, 0.4])
    found = s3.connect(p, q, 10.0)
    lift = lambda u: np.array([*(2 * u), u @ u - 1]) / (1 + u @ u)  # noqa: E731
    angle = np.arccos(lift(p) @ lift(q))
    turns = [angle, 2 * np.pi - angle, 2 * np.pi + angle]
    np.testing.assert_allclose(found.length, turns, atol=1e-6)
    np.testing.assert_allclose(abs(found.area), np.sin(turns) ** 2, rtol=1e-4)
    # Each arrives when it is followed.
    ends = s3.trace(np.array([p] * 3), found.direction, 10.0, s=found.length[-1:])
    np.testing.assert_allclose(ends.u[2, 0], q, atol=1e-6)


def test_several_points_are_connected_at_once(s3, random):
    q = random.uniform(-0.5, 0.5, (5, 3))
    together = s3.connect([0.3, 0.1, 0.0], q, 4.0)
    for i, point in enumerate(q):
        alone = s3.connect([0.3, 0.1, 0.0], point, 4.0)
        np.testing.assert_allclose(together.length[together.index == i], alone.length, rtol=1e-6)


def test_results_do_not_depend_on_threads(wormhole, random):
    directions = random.normal(size=(600, 3))
    with gf.threads(1):
        assert gf.thread_count() == 1
        alone = wormhole.trace([3, 0, 0], directions)
    with gf.threads(3):
        assert gf.thread_count() == 3
        with gf.threads(2):
            assert gf.thread_count() == 2
        together = wormhole.trace([3, 0, 0], directions)
    np.testing.assert_array_equal(alone.u, together.u)
    np.testing.assert_array_equal(alone.end, together.end)


def test_light_in_a_wind_tells_redshift_and_time():
    moving = gf.Manifold(
        'name = "river"\ncoordinates = ["x", "y", "z"]\nmetric = { conformal = "1" }\n'
        'wind = ["0.5*exp(-x^2)", "0", "0"]\n[cameras]\nlength = 6.0\n'
    )
    sight = moving.trace([-3, 0, 0], [1, 0, 0], samples=9)
    light = moving.trace([-3, 0, 0], [1, 0, 0], samples=9, forward=True)
    assert sight.g is not None and sight.g[0] == 1.0 and np.isfinite(sight.g).all()
    assert sight.u[-1, 0] < 3.0 < light.u[-1, 0]
