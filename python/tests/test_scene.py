"""Scenes and pictures, against the command line."""

import pickle

import geofan as gf
import numpy as np
import pytest
from conftest import MESHES, SCENES

SIZE = (48, 27)


def test_a_scene_file_gives_the_picture_of_the_command_line(command, tmp_path):
    for name in ("wormhole-gallery", "s3-lamp"):
        told = command(
            "render", SCENES / f"{name}.toml", "--size", "48x27", "-o", tmp_path / "told.exr"
        )
        theirs = gf.Image.open(tmp_path / "told.exr")
        mine = gf.Scene(SCENES / f"{name}.toml").render(size=SIZE)
        assert mine.tracer == told["tracer"] == "exact" and mine.size == SIZE
        # EXR files of pictures hold halves.
        np.testing.assert_allclose(mine.rgb, theirs.rgb, rtol=1e-3, atol=1e-4)
        assert mine.layers.keys() == theirs.layers.keys()
        for layer in ("id", "exit", "flagged"):
            np.testing.assert_array_equal(mine[layer], theirs[layer])
        np.testing.assert_allclose(mine["Z"], theirs["Z"], rtol=1e-3)


def test_a_picture_by_table_is_close_to_the_exact_one(bump, table):
    scene = gf.Scene(bump, sky="grid")
    camera = bump.camera({"c": 3.0}, [-1, 0, 0])
    by_table = scene.render(table, camera=camera, size=SIZE)
    exact = scene.render(camera=camera, size=SIZE)
    assert (by_table.tracer, exact.tracer) == ("table", "exact")
    assert np.abs(by_table.rgb - exact.rgb).mean() < 0.02
    np.testing.assert_array_equal(by_table["exit"], exact["exit"])
    assert scene.render(camera=camera, size=SIZE, tracer="local").tracer == "local"
    compared = scene.compare(table, camera=camera, size=SIZE, frames=2)
    assert compared.report["flip"] < 0.05 and compared.flip.shape == SIZE[::-1]
    assert "PSNR" in str(compared) and "data:image/png" in compared._repr_html_()
    np.testing.assert_array_equal(compared.exact.rgb, exact.rgb)


def test_a_scene_in_code_is_that_of_its_file(command, tmp_path):
    flat = gf.catalogue.flat()
    (tmp_path / "flat.toml").write_text(flat.text)
    scene = gf.Scene(flat, sky={"length": (0.1, 0.2, 0.3)})
    scene.add(MESHES / "letter-F.obj", at=[2, 0, 0], scale=0.5, rotate=([0, 0, 1], 30)).light([0, 1, 2], 8.0)
    written = scene.text.replace('manifold = "', f'manifold = "{tmp_path}/flat.toml" # "', 1)
    written += "\n[camera]\nat = [0, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n"
    (tmp_path / "scene.toml").write_text(written)
    command("render", tmp_path / "scene.toml", "--size", "48x27", "--length", 9, "-o", tmp_path / "a.png")
    camera = flat.camera([0, 0, 0], [1, 0, 0])
    mine = scene.render(camera=camera, size=SIZE, length=9)
    mine.save(tmp_path / "b.png")
    assert (tmp_path / "a.png").stat().st_size > 0
    np.testing.assert_array_equal(gf.Image.open(tmp_path / "a.png").rgb, gf.Image.open(tmp_path / "b.png").rgb)
    assert set(np.unique(mine["id"])) == {0, 1}


def test_meshes_of_arrays_stand_where_they_are_put():
    flat = gf.catalogue.flat()
    vertices = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], float)
    red = gf.Scene(flat).add((vertices, [[0, 1, 2], [0, 2, 3]]), at=[2, 0, 0], color=(1, 0, 0))
    picture = red.render(camera=flat.camera([0, 0, 0], [1, 0, 0]), size=(40, 40), length=5)
    inside = picture["id"] == 1
    np.testing.assert_allclose(picture["P.X"][inside], 2.0, rtol=1e-6)
    # Half as wide as far: a quarter of the view of 90°.
    assert abs(inside.mean() - 0.25) < 0.02
    assert (picture.rgb[inside][:, 1:] == 0).all() and (picture.rgb[inside][:, 0] > 0).any()
    again = pickle.loads(pickle.dumps(red))
    seen = again.render(camera=flat.camera([0, 0, 0], [1, 0, 0]), size=(40, 40), length=5)
    np.testing.assert_array_equal(seen.rgb, picture.rgb)


def test_the_path_tracer_lights_a_surface():
    flat = gf.catalogue.flat()
    floor = np.array([[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], float)
    scene = gf.Scene(flat).add((floor, [[0, 1, 2], [0, 2, 3]]), at=[0, 0, -1]).light([0, 0, 1], 10.0)
    camera = flat.camera([0, 0, 0.5], [1, 0, -1])
    picture = scene.render(camera=camera, size=(16, 9), spp=4, tracer="path", length=8)
    assert picture.tracer == "path" and picture.rgb.max() > 0 and "Z" in picture.layers


def test_cameras_move_along_geodesics_with_their_axes():
    sphere = gf.catalogue.s3()
    camera = sphere.camera([0.2, 0.1, -0.3], [1, 2, 0.5])
    around = camera.moved(forward=2 * np.pi)
    np.testing.assert_allclose(around.at, camera.at, atol=1e-8)
    np.testing.assert_allclose(around.look, camera.look, atol=1e-8)
    metric = sphere.metric_at(camera.moved(right=1).at)
    axes = camera.moved(right=1).axes
    np.testing.assert_allclose(axes @ metric @ axes.T, np.eye(3), atol=1e-10)
    # A right-angled triangle of three right angles has an area of π/2.
    leg = camera
    for _ in range(3):
        leg = leg.moved(forward=np.pi / 2).turned(right=90)
    np.testing.assert_allclose(leg.at, camera.at, atol=1e-8)
    np.testing.assert_allclose(leg.look, camera.look, atol=1e-8)


def test_cameras_turn_in_their_own_axes():
    flat = gf.catalogue.flat()
    camera = flat.camera([0, 0, 0], [1, 0, 0], fov=60)
    np.testing.assert_allclose(camera.right, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(camera.turned(right=90).look, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(camera.turned(up=90).look, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(camera.turned(roll=90).up, [0, -1, 0], atol=1e-12)
    assert camera.zoomed(30).fov == 30
    directions = camera.directions((3, 3))
    np.testing.assert_allclose(directions[1, 1], camera.look, atol=1e-12)
    assert directions[0, 1, 2] > 0 > directions[1, 2, 1]
    again = pickle.loads(pickle.dumps(camera.turned(right=20, up=10)))
    np.testing.assert_allclose(again.axes, camera.turned(right=20, up=10).axes, atol=1e-12)


@pytest.mark.parametrize(
    "call",
    [
        lambda s, c: s.render(),
        lambda s, c: s.render(camera="near"),
        lambda s, c: s.render(camera=c, size=(0, 5)),
        lambda s, c: s.render(camera=c, size=(10**9, 10**9)),
        lambda s, c: s.render(camera=c, spp=0),
        lambda s, c: s.render(camera=c, tracer="table"),
        lambda s, c: s.render(camera=c, tracer="wrong"),
        lambda s, c: s.render(camera=c, error=-1),
        lambda s, c: s.render(camera=c, tolerance=5),
        lambda s, c: s.render(camera=c, length=np.inf),
        lambda s, c: s.add("no-such-file.obj", at=[1, 0, 0]).render(camera=c, length=3),
        lambda s, c: s.add((np.zeros((3, 3)), [[0, 1, 2]]), at=[1, 0, 0]).render(camera=c, length=3),
        lambda s, c: s.add((np.eye(3), [[0, 1, 7]]), at=[1, 0, 0]).render(camera=c, length=3),
        lambda s, c: s.add((np.eye(3) * np.nan, [[0, 1, 2]]), at=[1, 0, 0]).render(camera=c, length=3),
        lambda s, c: s.add((np.eye(3), [[0, 1, 2]]), at=[1, 0, 0], scale=-1).render(camera=c, length=3),
        lambda s, c: s.add((np.eye(3), [[0, 1, 2]]), at=[1, 0, 0], placement="near").render(camera=c, length=3),
        lambda s, c: s.add(17, at=[1, 0, 0]),
        lambda s, c: s.add((np.eye(3), [[0, 1, 2]]), at=[1, 0]),
        lambda s, c: s.sky({"nowhere": "grid"}).render(camera=c, length=3),
        lambda s, c: s.sky((-1, 0, 0)),
        lambda s, c: s.render(camera=gf.catalogue.s3().camera([0, 0, 0], [1, 0, 0]), length=3),
    ],
)
def test_bad_scenes_raise_an_input_error(call):
    flat = gf.catalogue.flat()
    with pytest.raises(gf.InputError):
        call(gf.Scene(flat), flat.camera([0, 0, 0], [1, 0, 0]))


def test_a_mistake_in_a_scene_file_has_its_place(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text('manifold = "flat.toml"\n[camera]\nat = [0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n')
    with pytest.raises(gf.SceneError) as caught:
        gf.Scene(path)
    assert caught.value.line == 3
    path.write_text(f'manifold = "{tmp_path}/m.toml"\n[camera]\nat = [0, 0, 0]\nlook = [1, 0, 0]\nup = [0, 0, 1]\n')
    (tmp_path / "m.toml").write_text('name = "m"\ncoordinates = ["x", "y", "z"]\nmetric = { conformal = "q" }\n')
    with pytest.raises(gf.ManifoldError) as caught:
        gf.Scene(path)
    assert caught.value.line == 3 and caught.value.file.endswith("m.toml")


def test_a_bundle_of_another_space_is_refused(table):
    with pytest.raises(gf.InputError, match="another manifold"):
        gf.Scene(SCENES / "s3-lamp.toml").render(table, size=SIZE)
