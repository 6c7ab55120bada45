"""Bad input raises the typed exception with its place, and nothing else."""

import copy
import pickle

import geofan as gf
import numpy as np
import pytest


def test_a_mistake_in_a_text_has_its_line_column_and_hint():
    text = 'name = "wrong"\ncoordinates = ["x", "y", "z"]\nmetric = { conformal = "1 + sinn(x)" }\n'
    with pytest.raises(gf.ManifoldError) as caught:
        gf.Manifold(text)
    error = caught.value
    assert (error.line, error.column) == (3, 29)
    assert "sinn" in str(error) and "sin" in error.hint and "^" in error.report
    assert isinstance(error, ValueError) and isinstance(error, gf.GeofanError)
    again = pickle.loads(pickle.dumps(error))
    assert (again.line, again.hint, str(again)) == (error.line, error.hint, str(error))


def test_metrics_that_are_none_are_refused():
    with pytest.raises(gf.ManifoldError, match="positive definite"):
        gf.Manifold.metric(xx=1, yy=-1, zz=1, cameras={"at": [0, 0, 0]}, length=1)
    with pytest.raises(gf.ManifoldError, match="exactly one"):
        gf.Manifold.metric(conformal=1, xx=1)
    with pytest.raises(gf.ManifoldError, match="differ"):
        gf.Manifold.metric([[1, "x", 0], ["y", 1, 0], [0, 0, 1]])
    with pytest.raises(gf.ManifoldError, match="no parameter `b`"):
        gf.Manifold.metric(conformal="a", parameters={"a": 1.0}).set(b=2)
    with pytest.raises(gf.InputError, match="formula"):
        gf.Manifold.metric(conformal=True)
    with pytest.raises(gf.InputError, match="no such file"):
        gf.Manifold("there-is-no-such-file.toml")


@pytest.mark.parametrize(
    "call",
    [
        lambda m: m.trace([0, 0], [1, 0, 0], 1.0),
        lambda m: m.trace([0, 0, 0], [0, 0, 0], 1.0),
        lambda m: m.trace([0, 0, np.nan], [1, 0, 0], 1.0),
        lambda m: m.trace([0, 0, 0], [1, np.inf, 0], 1.0),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], -1.0),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], np.nan),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], "far"),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, samples=1),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, samples=-3),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, samples=2.5),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, samples=10**30),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, s=[1, 0]),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, s=[-1]),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, s=[]),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, s=[[1.0]]),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, tolerance=0),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 1.0, tolerance=1),
        lambda m: m.trace(np.zeros((2, 3)), np.ones((3, 3)), 1.0),
        lambda m: m.trace("here", [1, 0, 0], 1.0),
        lambda m: m.trace([0, 0, 0], [1 + 1j, 0, 0], 1.0),
        lambda m: m.metric_at(1.0),
        lambda m: m.metric_at([np.inf, 0, 0]),
        lambda m: m.christoffel([[0, 0, 0], [9, 0, 0]]),
        lambda m: m.connect([0, 0, 0], [[0, 0, np.nan]], 1.0),
        lambda m: m.connect([9, 0, 0], [0, 0, 0], 1.0),
        lambda m: m.connect([0, 0, 0], [0, 0, 0], 0.0),
        lambda m: m.transport(("t", "u", "0"), [1, 0, 0]),
        lambda m: m.transport(("t", "0", "0"), [1, 0, 0], (0, np.nan)),
        lambda m: m.transport(("5*t", "0", "0"), [1, 0, 0]),
        lambda m: m.transport(np.zeros((0, 3)), [1, 0, 0]),
        lambda m: m.camera([0, 0, 0], [1, 0, 0], [1, 0, 0]),
        lambda m: m.camera([0, 0, 0], [1, 0, 0], [0, 0, 1], fov=180),
        lambda m: m.camera({"q": 1}, [1, 0, 0]),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).moved(forward=np.nan),
        lambda m: m.bake(0.0),
        lambda m: m.bake(1.0, length=-1),
        lambda m: m.bake(1.0, certify_rays=0),
        lambda m: m.bake(1.0, resume=True),
        lambda m: m.bake(1.0, out="/there/is/no/such/folder/b.fan"),
        lambda m: gf.Bundle(__file__),
        lambda m: gf.Bundle.from_bytes(b"GEOFAN"),
        lambda m: gf.threads(0).__enter__(),
        lambda m: gf.threads(-1),
        lambda m: gf.sweep([]),
    ],
)
def test_bad_arguments_raise_an_input_error(call):
    m = gf.Manifold.metric(
        conformal="1/(1 + x^2)", domain={"x": (-3, 3)}, cameras={"parameters": {"c": (0, 1)}, "at": ["c", 0, 0]}, length=2
    )
    with pytest.raises(gf.InputError):
        call(m)


def test_the_row_at_fault_is_named():
    m = gf.Manifold.metric(conformal=1, domain={"x": (-3, 3)})
    at = np.zeros((1000, 3))
    at[617, 0] = 4.0
    with pytest.raises(gf.InputError, match=r"at\[617\].*limits") as caught:
        m.trace(at, [1, 0, 0], 1.0)
    assert caught.value.subject == "at[617]"


def test_a_manifold_without_length_asks_for_one():
    with pytest.raises(gf.InputError, match="length"):
        gf.Manifold.metric(conformal=1).trace([0, 0, 0], [1, 0, 0])


def test_manifolds_are_pickled_copied_and_compared():
    m = gf.catalogue.schwarzschild(M=0.95)
    for same in (pickle.loads(pickle.dumps(m)), copy.deepcopy(m)):
        assert same == m and hash(same) == hash(m) and same.parameters == {"M": 0.95}
        assert not same.differences(m)
    assert m != m.set(M=1) and m.differences(m.set(M=1))


def test_files_that_are_no_text_or_folders_are_refused(tmp_path):
    (tmp_path / "binary.toml").write_bytes(b"\x00\xff\xfe")
    for path in (tmp_path, tmp_path / "binary.toml"):
        with pytest.raises(gf.InputError):
            gf.Manifold(path)
