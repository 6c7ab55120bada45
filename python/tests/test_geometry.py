"""Curvature, frames and transport against closed forms, SymPy and the command line."""

import geofan as gf
import numpy as np
import pytest
from conftest import MANIFOLDS


def test_the_three_sphere_has_constant_curvature_one(s3, random):
    u = random.normal(size=(4, 5, 3))
    g, riemann = s3.metric_at(u), s3.riemann(u)
    constant = np.einsum("...ac,...bd->...abcd", g, g) - np.einsum("...ad,...bc->...abcd", g, g)
    assert riemann.shape == (4, 5, 3, 3, 3, 3)
    np.testing.assert_allclose(riemann, constant, atol=1e-11)
    np.testing.assert_allclose(s3.ricci(u), 2 * g, atol=1e-11)
    np.testing.assert_allclose(s3.scalar_curvature(u), 6, rtol=1e-11)


def test_frames_are_orthonormal_and_follow_the_order_of_coordinates(wormhole, random):
    u = random.uniform(-5, 5, size=(7, 3))
    frame, g = wormhole.frame(u), wormhole.metric_at(u)
    np.testing.assert_allclose(np.einsum("nia,nab,njb->nij", frame, g, frame), np.eye(3) + 0 * frame, atol=1e-12)
    assert np.all(frame[:, 0, 1:] == 0) and np.all(frame[:, 1, 2] == 0)


def test_christoffel_symbols_are_those_that_sympy_derives():
    sympy = pytest.importorskip("sympy")
    x, y, z = symbols = sympy.symbols("x y z")
    g = sympy.Matrix([[1 + y**2, x * z / 5, 0], [x * z / 5, sympy.exp(x / 3), 0], [0, 0, sympy.cosh(y) ** 2]])
    manifold = gf.Manifold.metric(g)
    inverse = g.inv()
    at = {x: 0.3, y: -0.4, z: 0.7}
    for k in range(3):
        for i in range(3):
            for j in range(3):
                terms = (
                    inverse[k, a] * (g[a, i].diff(symbols[j]) + g[a, j].diff(symbols[i]) - g[i, j].diff(symbols[a]))
                    for a in range(3)
                )
                truth = float((sum(terms) / 2).subs(at))
                found = manifold.christoffel([0.3, -0.4, 0.7])[k, i, j]
                assert abs(found - truth) < 1e-12, (k, i, j)


@pytest.mark.parametrize("name", ["schwarzschild", "nil", "three-bumps", "sol"])
def test_the_command_line_tells_the_same_geometry(command, name):
    at = [4.1, 0.3, -0.2]
    told = command("info", MANIFOLDS / f"{name}.toml", "--at", ",".join(map(str, at)))["at"]
    manifold = gf.Manifold(MANIFOLDS / f"{name}.toml")
    np.testing.assert_array_equal(manifold.metric_at(at), told["metric"])
    np.testing.assert_array_equal(manifold.inverse_metric(at), told["inverse"])
    np.testing.assert_array_equal(manifold.connection(at), told["connection"])
    np.testing.assert_array_equal(manifold.frame(at), told["frame"])
    np.testing.assert_array_equal(manifold.christoffel(at), told["christoffel"])
    np.testing.assert_array_equal(manifold.riemann(at), told["riemann"])
    np.testing.assert_array_equal(manifold.ricci(at), told["ricci"])
    assert manifold.scalar_curvature(at) == told["scalar"]


def test_transport_around_a_loop_turns_by_the_area_inside():
    sphere = gf.Manifold.metric(xx=1, yy="sin(x)^2", zz=1, domain={"x": (0.1, 3.0)})
    start = np.array([1.0, 0.0, 0.0])
    for colatitude in (0.4, 1.0, 1.5):
        end = sphere.transport((colatitude, "t", 0), start, (0, 2 * np.pi))
        turn = 2 * np.pi * np.cos(colatitude)
        expected = [np.cos(turn), -np.sin(turn) / np.sin(colatitude), 0.0]
        np.testing.assert_allclose(end, expected, atol=1e-9)


def test_transport_through_points_is_that_along_their_lines(wormhole, random):
    w = random.normal(size=(2, 4, 3))
    through = wormhole.transport(np.array([[3.0, 0.2, 0.1], [4.0, 1.2, 0.5]]), w)
    along = wormhole.transport(("3 + t", "0.2 + t", "0.1 + 0.4*t"), w)
    np.testing.assert_allclose(through, along, atol=1e-9)
    back = wormhole.transport(("3 + t", "0.2 + t", "0.1 + 0.4*t"), along, (1, 0))
    np.testing.assert_allclose(back, w, atol=1e-9)


def test_curves_that_leave_the_space_or_jump_carry_nothing():
    shell = gf.Manifold.metric(conformal=1, domain={"x": (-4, 4), "inside": ["x^2 + y^2 + z^2 - 1"]})
    through = [[2, 0.3, 0], [-2, 0.3, 0]]
    for curve in (("2 - 4*t", "0.3", "0"), through, ("3 + 8*t*(1 - t)", "0.3*t", "0"), ("2", "if(t < 0.5, 0, 1)", "t")):
        with pytest.raises(gf.InputError, match="inside|limit|jumps|below|beyond|from -4"):
            shell.transport(curve, [0, 1, 0])


def test_points_on_both_sides_of_a_limit_are_not_joined_the_long_way_round():
    sphere = gf.Manifold.metric(
        xx=1, yy="sin(x)^2", zz=1, domain={"x": (0.1, 3.0), "y": (-np.pi, np.pi), "periodic": ["y"]}
    )
    around = np.linspace(0, 2 * np.pi, 20001)
    points = np.stack([np.ones_like(around), around, np.zeros_like(around)], axis=-1)
    turn = 2 * np.pi * np.cos(1)
    end = sphere.transport(points, [1, 0, 0])
    np.testing.assert_allclose(end, [np.cos(turn), -np.sin(turn) / np.sin(1), 0], atol=1e-6)
    points[:, 1] = (around + np.pi) % (2 * np.pi) - np.pi
    with pytest.raises(gf.InputError, match="half a period of `y`"):
        sphere.transport(points, [1, 0, 0])


def test_embeddings_and_metrics_of_one_space_agree(random):
    u = random.uniform(-1, 1, size=(6, 3))
    graph = gf.Manifold.embedding(["x", "y", "z", "a*x*y"], parameters={"a": 0.5})
    metric = gf.Manifold.metric(
        xx="1 + a^2*y^2", yy="1 + a^2*x^2", zz=1, xy="a^2*x*y", parameters={"a": 0.5}
    )
    np.testing.assert_allclose(graph.riemann(u), metric.riemann(u), atol=1e-12)
    np.testing.assert_allclose(graph.set(a=2).ricci(u), metric.set(a=2).ricci(u), atol=1e-11)
