"""Other packages: meshes, tables, pictures, plots, symbols, processes."""

import concurrent.futures
import copy
import multiprocessing
import pickle

import geofan as gf
import numpy as np
import pytest
from conftest import MESHES


def lengths_of(job):
    """Traces in a worker process."""
    manifold, directions = job
    with gf.threads(1):
        return manifold.trace([9, 0, 0], directions).length


@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_workers_of_multiprocessing_trace(method, random):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip("not on this system")
    hole = gf.catalogue.schwarzschild()
    directions = random.normal(size=(40, 3))
    # The parent's threads have run before a fork.
    here = hole.trace([9, 0, 0], directions).length
    context = multiprocessing.get_context(method)
    with concurrent.futures.ProcessPoolExecutor(2, context) as pool:
        there = list(pool.map(lengths_of, [(hole, directions[:20]), (hole, directions[20:])]))
    np.testing.assert_array_equal(np.concatenate(there), here)


def test_threads_of_python_work_side_by_side(random):
    hole = gf.catalogue.schwarzschild()
    jobs = [(hole, directions) for directions in random.normal(size=(6, 30, 3))]
    with concurrent.futures.ThreadPoolExecutor(3) as pool:
        there = list(pool.map(lengths_of, jobs))
    for (_, directions), found in zip(jobs, there):
        np.testing.assert_array_equal(found, hole.trace([9, 0, 0], directions).length)


def test_dask_workers_trace(random):
    dask = pytest.importorskip("dask")
    hole = gf.catalogue.schwarzschild()
    parts = random.normal(size=(4, 10, 3))
    tasks = [dask.delayed(lengths_of)((hole, part)) for part in parts]
    found = dask.compute(*tasks, scheduler="processes", num_workers=2)
    np.testing.assert_array_equal(np.concatenate(found), hole.trace([9, 0, 0], parts.reshape(-1, 3)).length)


def test_meshes_of_trimesh_and_meshio():
    trimesh = pytest.importorskip("trimesh")
    meshio = pytest.importorskip("meshio")
    flat = gf.catalogue.flat()
    camera = flat.camera([0, 0, 0], [1, 0, 0])
    ball = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    same = meshio.Mesh(ball.vertices, [("triangle", ball.faces)])
    seen = [
        gf.Scene(flat).add(mesh, at=[3, 0, 0], scale=0.5).render(camera=camera, size=(64, 64), length=6)
        for mesh in (ball, same, (ball.vertices, ball.faces))
    ]
    np.testing.assert_array_equal(seen[0].rgb, seen[1].rgb)
    np.testing.assert_array_equal(seen[0].rgb, seen[2].rgb)
    # A disc of sine 1/6 in a view of 90°.
    radius = np.tan(np.arcsin(0.5 / 3))
    assert abs((seen[0]["id"] == 1).mean() / (np.pi * radius**2 / 4) - 1) < 0.05
    teapot = trimesh.load(MESHES / "teapot.obj", force="mesh")
    assert (gf.Scene(flat).add(teapot, at=[3, 0, 0], scale=0.3).render(camera=camera, size=(32, 32), length=6)["id"] == 1).any()


def test_paths_become_data_frames_and_datasets(random):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    s3 = gf.catalogue.s3()
    paths = s3.trace([0.1, 0, 0], random.normal(size=(5, 3)), 2.0, samples=4)
    frame = pandas.DataFrame(paths.columns())
    assert list(frame.columns) == ["ray", "s", "x", "y", "z", "vx", "vy", "vz", "area"] and len(frame) == 20
    np.testing.assert_array_equal(frame[frame.ray == 3][["x", "y", "z"]].to_numpy(), paths.u[3])
    data = paths.to_xarray()
    np.testing.assert_array_equal(data.u.sel(ray=2, coordinate="y"), paths.u[2, :, 1])
    assert dict(data.sizes) == {"ray": 5, "sample": 4, "coordinate": 3, "vector": 3}


def test_an_exr_file_is_read_by_openexr(tmp_path):
    openexr = pytest.importorskip("OpenEXR")
    flat = gf.catalogue.flat()
    image = gf.Scene(flat, sky=(0.25, 0.5, 1.0)).render(camera=flat.camera([0, 0, 0], [1, 0, 0]), size=(20, 10), length=3)
    image.save(tmp_path / "a.exr")
    with openexr.File(str(tmp_path / "a.exr")) as file:
        channels = file.channels()
        colour = channels["RGB"].pixels if "RGB" in channels else channels["RGBA"].pixels
        np.testing.assert_allclose(colour[..., :3], image.rgb, rtol=1e-3)
        np.testing.assert_allclose(channels["Z"].pixels, image["Z"], rtol=1e-3)
    again = gf.Image.open(tmp_path / "a.exr")
    assert again.layers.keys() == image.layers.keys() and again.notes["tracer"] == "exact"


def test_a_fan_is_drawn_by_matplotlib(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    hole = gf.catalogue.schwarzschild()
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    fan = hole.trace([9, 0, 0], np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1), 12, samples=6)
    figure, axes = pyplot.subplots()
    arrows = axes.quiver(fan.u[..., 0], fan.u[..., 1], fan.v[..., 0], fan.v[..., 1], angles="xy")
    assert arrows.N == 24 * 6
    figure.savefig(tmp_path / "fan.png")
    assert (tmp_path / "fan.png").stat().st_size > 5000


def test_pictures_show_themselves_and_are_arrays():
    flat = gf.catalogue.flat()
    image = gf.Scene(flat, sky="grid").render(camera=flat.camera([0, 0, 0], [1, 0, 0]), size=(20, 10), length=3)
    assert image._repr_png_().startswith(b"\x89PNG")
    assert np.asarray(image) is image.rgb and image.rgb.dtype == np.float32
    assert np.array(image, dtype=float).shape == (10, 20, 3)


def test_metrics_by_sympy_are_those_by_text(random):
    sympy = pytest.importorskip("sympy")
    x, y, z, a = sympy.symbols("x y z a", real=True)
    r = sympy.sqrt(x**2 + y**2 + z**2)
    index = 1 + a / (1 + sympy.Abs(x)) ** 2 + sympy.Piecewise((sympy.exp(-r), r < 1), (sympy.Max(x, y) / 9 + 1, True))
    text = "1 + a/(1 + abs(x))^2 + if(sqrt(x^2 + y^2 + z^2) < 1, exp(-sqrt(x^2 + y^2 + z^2)), max(x, y)/9 + 1)"
    u = random.uniform(-2, 2, (30, 3))
    metrics = [gf.Manifold.metric(conformal=n, parameters={"a": 0.5}).metric_at(u) for n in (index, text)]
    np.testing.assert_allclose(metrics[0], metrics[1], rtol=1e-14)
    with pytest.raises(gf.InputError, match="zeta"):
        gf.Manifold.metric(conformal=sympy.zeta(x))
    polar = gf.Manifold.metric(sympy.diag(1, sympy.sin(x) ** 2, sympy.Rational(1, 3)), domain={"x": (0.1, 3)})
    np.testing.assert_allclose(polar.metric_at([1, 0, 0]), np.diag([1, np.sin(1) ** 2, 1 / 3]), rtol=1e-15)


def test_sympy_s_minima_of_several(random):
    sympy = pytest.importorskip("sympy")
    x, y, z = sympy.symbols("x y z", real=True)
    index = 2 + sympy.Max(x, y, z, 0) + sympy.Min(x, y, z) / 9
    u = random.uniform(-1, 1, (20, 3))
    expected = 2 + np.maximum(u.max(1), 0) + u.min(1) / 9
    found = gf.Manifold.metric(conformal=index).metric_at(u)[:, 0, 0]
    np.testing.assert_allclose(found, expected**2, rtol=1e-14)


@pytest.mark.parametrize(
    ("formula", "written"),
    [
        ("2*(-x)", r"2 \, \left(-x\right)"),
        ("exp(y*(-0.5))", r"\exp\left(y \, \left(-0.5\right)\right)"),
        ("x - -y", r"x - \left(-y\right)"),
        ("x + (-y)*z", r"x + \left(-y \, z\right)"),
        ("-x*y", r"-x \, y"),
        ("2*x", r"2 \, x"),
        ("x < y", "x < y"),
        ("x < y < z", r"\texttt{x < y < z}"),
    ],
)
def test_formulas_as_latex(formula, written):
    from geofan._latex import latex

    assert latex(formula) == written


def test_manifolds_show_their_line_element():
    html = gf.catalogue.schwarzschild()._repr_html_()
    assert r"\mathrm{d}s^2" in html and r"\frac{M}{2 \, \rho}" in html and "rotations about the origin" in html
    assert "horizon, sky" in html and "mirrors found" in html
    assert r"\sqrt" in gf.catalogue.s3_graph()._repr_html_() or "f(" in gf.catalogue.s3_graph()._repr_html_()


def test_every_space_of_the_catalogue_can_be_made():
    names = gf.catalogue.names()
    assert "schwarzschild" in names and "nil" in names and set(names) <= set(dir(gf.catalogue))
    for name in names:
        manifold = getattr(gf.catalogue, name)()
        assert manifold.name and manifold._native.lines()
    with pytest.raises(AttributeError, match="no space"):
        gf.catalogue.there_is_none
    with pytest.raises(gf.ManifoldError):
        gf.catalogue.schwarzschild(Q=1)


def test_a_sweep_is_a_table_of_columns(tmp_path):
    pandas = pytest.importorskip("pandas")
    s3 = gf.catalogue.s3()
    columns = gf.sweep(s3, tmp_path / "sweep", max_error=[5.0], cells=[2], rays=200)
    frame = pandas.DataFrame(columns)
    assert len(frame) >= 2 and {"disk_bytes", "screen_p99_mrad", "manifold"} <= set(frame.columns)
    assert (tmp_path / "sweep" / "sweep.csv").exists()


def test_a_sweep_takes_manifolds_of_one_name():
    first, second = (gf.Manifold.metric(conformal=n, cameras={"at": [0, 0, 0]}, length=1) for n in (1, 2))
    columns = gf.sweep([first, second], max_error=[5.0], cells=[2], rays=200)
    assert set(columns["manifold"]) == {"metric", "metric-2"}


def test_a_sweep_reads_manifolds_with_fields_where_they_are(tmp_path):
    from geofan._sweep import _files_of

    mirage, flat = gf.catalogue.road_mirage(), gf.Manifold.metric(conformal=1, name="flat")
    files = _files_of([mirage, flat], tmp_path)
    assert [gf.Manifold(file) for file in files] == [mirage, flat]
    assert [file.startswith(str(tmp_path)) for file in files] == [False, True]


def test_a_manifold_with_a_field_is_found_from_elsewhere(tmp_path, monkeypatch):
    np.save(tmp_path / "n.npy", 1 + np.random.default_rng(1).random((6, 6, 6)) / 9)
    text = 'name = "air"\ncoordinates = ["x", "y", "z"]\nmetric = { conformal = "a*n(x, y, z)" }\n'
    text += '[parameters]\na = 1.0\n[field.n]\nfile = "n.npy"\nbox = { x = [-1, 1], y = [-1, 1], z = [-1, 1] }\n'
    (tmp_path / "air.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    air = gf.Manifold("air.toml")
    there = tmp_path / "elsewhere"
    there.mkdir()
    monkeypatch.chdir(there)
    for same in (air.set(a=1.0), copy.deepcopy(air), pickle.loads(pickle.dumps(air)), air.set(a=2.0).set(a=1.0)):
        np.testing.assert_array_equal(same.metric_at([0.1, 0.2, 0.3]), air.metric_at([0.1, 0.2, 0.3]))


def test_a_manifold_keeps_the_samples_of_its_field_when_their_file_changes(tmp_path):
    def air(factor):
        np.save(tmp_path / "n.npy", factor * (1 + np.random.default_rng(1).random((6, 6, 6)) / 9))
        return gf.Manifold(tmp_path / "air.toml")

    text = 'name = "air"\ncoordinates = ["x", "y", "z"]\nmetric = { conformal = "a*n(x, y, z)" }\n'
    text += '[parameters]\na = 1.0\n[field.n]\nfile = "n.npy"\nbox = { x = [-1, 1], y = [-1, 1], z = [-1, 1] }\n'
    (tmp_path / "air.toml").write_text(text)
    first, second = air(1), air(2)
    assert first != second and len({first, second}) == 2 and first.differences(second)
    (tmp_path / "n.npy").unlink()
    for same in (first.set(a=1.0), copy.deepcopy(first), pickle.loads(pickle.dumps(first))):
        assert same == first and not same.differences(first)
