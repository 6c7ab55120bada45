"""Bad input raises the typed exception with its place, and nothing else."""

import copy
import pickle

import geofan as gf
import numpy as np
import pytest
from conftest import SCENES


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


def drawn(manifold, **options):
    options = {"camera": manifold.camera([0, 0, 0], [1, 0, 0]), "size": (4, 4)} | options
    return gf.Scene(manifold, sky="grid").render(**options)


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
        lambda m: m.trace(np.array([0, 0, 1j]), [1, 0, 0], 1.0),
        lambda m: m.trace(np.ma.masked_array([0.0, 0, 0], [True, False, False]), [1, 0, 0], 1.0),
        lambda m: m.trace([10**400, 0, 0], [1, 0, 0], 1.0),
        lambda m: m.trace([0, 0, 0], [1, 0, 0], 10**400),
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
        lambda m: m.transport(("t", "0", "0"), [1, 0, 0], (0,)),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).moved(forward=1e300),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).directions((3,)),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).directions((3, 4, 5)),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).directions(3),
        lambda m: m.camera([0, 0, 0], [1, 0, 0]).directions((0, 4)),
        lambda m: m.bake_share((1,), "x.fan"),
        lambda m: m.bake_share(1, "x.fan"),
        lambda m: m.bake_share((1, 2**40), "x.fan"),
        lambda m: m.journey([(0, m.camera([0, 0, 0], [1, 0, 0])), (1, "there")], 2),
        lambda m: m.journey([(0, m.camera([0, 0, 0], [1, 0, 0])), (1,)], 2),
        lambda m: m.journey([(i, gf.catalogue.s3().camera([0, 0, 0], [1, 0, 0])) for i in (0, 1)], 2),
        lambda m: m.bake(0.0),
        lambda m: m.bake(1.0, length=-1),
        lambda m: m.bake(1.0, certify_rays=0),
        lambda m: m.bake(1.0, resume=True),
        lambda m: m.bake(1.0, out="/there/is/no/such/folder/b.fan"),
        lambda m: gf.Bundle(__file__),
        lambda m: gf.Bundle.from_bytes(b"GEOFAN"),
        lambda m: gf.Bundle.merge("s1.fan", "x.fan"),
        lambda m: gf.Bundle.from_bytes(3),
        lambda m: gf.Bundle.from_bytes(bytearray(b"GEOFAN")),
        lambda m: gf.Manifold.metric(conformal="a", parameters={"a": 10**400}),
        lambda m: drawn(m, camera=3),
        lambda m: drawn(m, bundle="x.fan"),
        lambda m: drawn(m, tracer="path", bounces=2**40),
        lambda m: drawn(m, size=(3,)),
        lambda m: drawn(m, tracer=5),
        lambda m: m.transport(5, [1, 0, 0]),
        lambda m: gf.Scene(m).light([0, 0, 0], [1, 2]),
        lambda m: gf.Scene(m).light([0, 0, 0], "bright"),
        lambda m: gf.Scene(m).add((np.eye(3), [[0, 1, 2]]), [0, 0, 0], rotate=([0, 0, 1],)),
        lambda m: gf.page(m, camera="main", wasm=__file__),
        lambda m: gf.page(m, "x.fan", wasm=__file__),
        lambda m: gf.Image(np.zeros((2, 2))).save("x.png"),
        lambda m: gf.Image(np.zeros((2, 2, 3)), {"id": np.full((2, 2), -1)}).save("x.exr"),
        lambda m: gf.Image(np.zeros((2, 2, 3)), {"wave": np.zeros((2, 2), complex)}).save("x.exr"),
        lambda m: gf.Image(np.zeros((2, 2, 3)), {"wave": np.zeros(2)}).save("x.exr"),
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


def test_a_camera_of_a_wrong_type_is_refused_by_a_scene_file():
    scene = gf.Scene(SCENES / "s3-lamp.toml")
    with pytest.raises(gf.InputError, match="camera"):
        scene.render(camera=7, size=(4, 4))
    with pytest.raises(gf.InputError, match="camera"):
        scene.compare(camera=("main",), size=(4, 4))


def test_hyphens_of_paths_are_kept_in_errors(tmp_path):
    folder = tmp_path / "a-b"
    folder.mkdir()
    (folder / "no-bundle.fan").write_text("text")
    for call in (
        lambda: gf.Bundle(folder / "no-bundle.fan"),
        lambda: gf.Manifold(folder / "not-there.toml"),
        lambda: gf.Image(np.zeros((2, 2, 3))).save(folder / "x-y.jpg"),
    ):
        with pytest.raises(gf.InputError) as caught:
            call()
        assert "a-b" in caught.value.subject and "a-b" in str(caught.value)


def test_errors_name_the_arguments_of_python(bump, table):
    with pytest.raises(gf.InputError, match="raise max_size") as caught:
        bump.bake(0.001, max_size=3000, certify_rays=500)
    assert "--" not in str(caught.value) and str(caught.value).count("raise max_size") == 1
    assert caught.value.hint == "loosen max_error or raise max_size"
    with pytest.raises(gf.InputError) as caught:
        gf.Bundle.merge([], "x.fan")
    assert caught.value.subject == "shares"
    with pytest.raises(gf.InputError) as caught:
        table.paths([1, 0, 0], [1, 0, 0], [0, 99])
    assert caught.value.subject == "s"
    with pytest.raises(gf.InputError) as caught:
        table.trace([[1, 0, 0], [4.9, 0, 0]], [1, 0, 0])
    assert caught.value.subject == "at[1]"
    with pytest.raises(gf.InputError, match="camera: the scene has no view"):
        gf.Scene(SCENES / "s3-lamp.toml").camera("there is none")


def test_key_poses_that_are_no_text_are_refused(bump, tmp_path):
    (tmp_path / "poses.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(gf.InputError, match="no text"):
        bump.journey(tmp_path / "poses.toml", 2)


def test_corners_of_faces_are_whole_numbers():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    scene = gf.Scene(gf.Manifold.metric(conformal=1, cameras={"at": [0, 0, 0]}, length=1), sky="grid")
    with pytest.raises(gf.InputError, match="whole numbers"):
        scene.add((points, np.array([[0.5, 1.5, 2.5]])), [6, 0, 0])
    with pytest.raises(gf.InputError, match="whole numbers"):
        scene.add((points, np.array([[True, False, True]])), [6, 0, 0])
    scene.add((points, np.array([[0.0, 1.0, 2.0]])), [6, 0, 0])


def test_one_condition_of_a_domain_needs_no_list():
    given = {"cameras": {"at": [0, 0, 0]}, "length": 1}
    one, several = (gf.Manifold.metric(conformal=1, domain={"inside": x}, **given) for x in ("x + 2", ["x + 2"]))
    assert one.text == several.text
