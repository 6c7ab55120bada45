"""Scenes and pictures, against the command line."""

import pickle
import subprocess
import sys
import warnings

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
    assert scene.compare(camera=camera, size=SIZE).approximate.tracer == "local"
    with pytest.raises(gf.InputError, match="length"):
        scene.render(table, camera=camera, size=SIZE, length=3)


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


@pytest.mark.parametrize(
    ("lens", "line", "size"),
    [
        ("", ("--crop", "7,5,20,11"), "48x27"),
        ("crop = [0.25, 0.5, 0.5, 0.5]", (), "48x28"),
        ('projection = "panorama"', (), "48x24"),
        ('projection = "fisheye"\nfov = 200', (), "40x40"),
        ('projection = "orthographic"\nwidth = 2.5', (), "40x30"),
        ('projection = "cube"', (), "48x32"),
        ("stereo = { separation = 0.2, convergence = 3.0 }", (), "60x20"),
        ('projection = "panorama"\nstereo = { separation = 0.2, layout = "over-under" }', (), "40x40"),
        ("velocity = [0.3, 0.1, 0.0]", (), "48x27"),
    ],
)
@pytest.mark.filterwarnings("ignore::geofan.GeofanWarning")
def test_cameras_of_all_kinds_draw_the_picture_of_the_command_line(command, tmp_path, bump, lens, line, size):
    (tmp_path / "bump.toml").write_text(bump.text)
    place = f"at = [2.5, 0.4, 0.1]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n{lens}\n"
    skies = 'sky = { pattern = "grid" }\nlength = { color = [0.1, 0.2, 0.3] }\n'
    letter = f'[[object]]\nmesh = "{MESHES}/letter-F.obj"\nat = [0.5, 0.6, 0.2]\nscale = 0.5\n'
    (tmp_path / "scene.toml").write_text(f'manifold = "bump.toml"\n[camera]\n{place}{letter}[sky]\n{skies}')
    told = command("render", tmp_path / "scene.toml", "--size", size, *line, "-o", tmp_path / "told.exr")
    theirs = gf.Image.open(tmp_path / "told.exr")
    crop = tuple(int(x) for x in line[1].split(",")) if line else None
    whole = tuple(int(x) for x in size.split("x"))
    scene = gf.Scene(tmp_path / "scene.toml")
    mine = scene.render(size=whole, crop=crop)
    assert mine.size == (told["width"], told["height"]) and mine.unfinished == told["unfinished"]
    mine.save(tmp_path / "mine.exr")
    again = gf.Image.open(tmp_path / "mine.exr")
    assert again.layers.keys() == theirs.layers.keys() and again._window == theirs._window
    np.testing.assert_array_equal(again.rgb, theirs.rgb)
    for name, layer in theirs.layers.items():
        np.testing.assert_array_equal(again[name], layer, name)
    assert {k: v for k, v in theirs.notes.items() if k != "command"} == {k: v for k, v in again.notes.items()}
    # The same camera, made in code, and sent to another process.
    made = pickle.loads(pickle.dumps(scene.camera()))
    assert made.projection == scene.camera().projection
    moved = scene.render(camera=made, size=whole, crop=crop)
    np.testing.assert_allclose(moved.rgb, mine.rgb, atol=2e-2)


def test_cameras_made_in_code_have_all_that_a_scene_file_says(bump):
    camera = bump.camera(
        {"c": 2.0}, [-1, 0, 0], projection="fisheye", fov=220, stereo={"separation": 0.1, "layout": "over-under"}
    )
    assert (camera.projection, camera.fov, camera.turned(up=5).projection) == ("fisheye", 220, "fisheye")
    assert "over-under" in camera.text and "fisheye" in repr(camera)
    moving = bump.camera([2, 0, 0], [-1, 0, 0], velocity=[0.5, 0, 0])
    assert moving.velocity.tolist() == [0.5, 0, 0] and camera.velocity.tolist() == [0, 0, 0]
    # Aberration: at half the speed of light, what is at 90° is seen at 120° from behind.
    still = bump.camera([2, 0, 0], [-1, 0, 0])
    assert moving.directions((1, 1)).shape == (1, 1, 3)
    assert np.allclose(moving.directions((3, 3))[1, 1], still.directions((3, 3))[1, 1])
    assert not np.allclose(moving.directions((3, 3))[0, 0], still.directions((3, 3))[0, 0])
    for wrong in (
        {"projection": "mirror"},
        {"projection": "cube", "fov": 90},
        {"projection": "orthographic"},
        {"velocity": [1, 0, 0]},
        {"rest": "static", "velocity": [0.1, 0, 0]},
        {"crop": [0.5, 0.5, 0.6, 0.1]},
        {"stereo": {"separation": -1}},
    ):
        with pytest.raises(gf.InputError) as caught:
            bump.camera([2, 0, 0], [-1, 0, 0], **wrong)
        assert caught.value.line is not None
    for camera in (bump.camera([2, 0, 0], [-1, 0, 0], projection="orthographic", width=2),):
        with pytest.raises(gf.InputError, match="different points"):
            camera.directions((3, 3))
        with pytest.raises(gf.InputError, match="angle of view"):
            camera.zoomed(30)


def test_a_journey_begins_and_ends_at_its_poses(bump, tmp_path):
    from_here = bump.camera([3, 0, 0], [-1, 0, 0], fov=60)
    to_there = bump.camera([1, 1, 0], [0, -1, 0.2], fov=80)
    way = bump.journey([(0, from_here), (2, to_there)], 9)
    for mine, given in ((way[0], from_here), (way[-1], to_there)):
        np.testing.assert_allclose(mine.axes, given.axes, atol=1e-6)
        assert abs(mine.fov - given.fov) < 1e-12
    poses = "".join(
        f"[[pose]]\ntime = {t}\nat = {c.at.tolist()}\nlook = {c.look.tolist()}\nup = {c.up.tolist()}\nfov = {c.fov}\n"
        for t, c in ((0, from_here), (2, to_there))
    )
    (tmp_path / "poses.toml").write_text(poses)
    for mine, theirs in zip(way, bump.journey(tmp_path / "poses.toml", 9)):
        np.testing.assert_allclose(mine.axes, theirs.axes, atol=1e-9)
    with pytest.raises(gf.InputError):
        bump.journey([(0, from_here)], 9)


def torus(across, around, radius=0.08):
    """Returns the corners and the quads of a torus."""
    i, j = np.meshgrid(np.arange(across), np.arange(around), indexing="ij")
    turn, roll = 2 * np.pi * i / across, 2 * np.pi * j / around
    distance = 1 + radius * np.cos(roll)
    points = np.stack([distance * np.cos(turn), distance * np.sin(turn), radius * np.sin(roll)], axis=-1)
    number = lambda i, j: i % across * around + j % around  # noqa: E731
    quads = np.stack([number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)], axis=-1)
    return points.reshape(-1, 3), quads.reshape(-1, 4)


MANY = """
import sys, geofan as gf, numpy as np
table = gf.Bundle(sys.argv[1])
space, points, quads = table.manifold, np.load(sys.argv[2]), np.load(sys.argv[3])
camera = space.camera([2.5, 0, 0.8], [-3, 0, -1], fov=60)
scenes = [gf.Scene(space, sky="grid").add((points, quads), at=[0, 0, 0]) for _ in range(12)]
pictures = [scene.render(table, camera=camera, size=(64, 40), spp=4) for scene in scenes]
assert all(np.array_equal(p.rgb, pictures[0].rgb) for p in pictures) and (pictures[0]["id"] == 1).any()
print("drawn")
"""


def test_scenes_are_drawn_wherever_python_keeps_them(table, tmp_path):
    """Vectors of a scene must be aligned; of so many Python objects some are not."""
    points, quads = torus(48, 12)
    np.save(tmp_path / "points.npy", points)
    np.save(tmp_path / "quads.npy", quads)
    line = [sys.executable, "-c", MANY, str(table.path), str(tmp_path / "points.npy"), str(tmp_path / "quads.npy")]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "drawn\n"), done.stderr


def test_a_scene_tells_what_a_camera_in_it_would_not_see(bump):
    scene = gf.Scene(bump)
    with pytest.warns(gf.GeofanWarning, match="nothing can be seen"):
        scene.render(camera=bump.camera([2.5, 0, 0], [-1, 0, 0]), size=(20, 10))
    with pytest.warns(gf.GeofanWarning, match="black in parts") as told:
        scene.sky("grid")
        short = scene.render(camera=bump.camera([2.5, 0, 0], [-1, 0, 0]), size=(20, 10), length=3)
    assert told[0].filename == __file__
    assert short.unfinished["length"] > 0.5 and short.unfinished["enough"] > 3


def test_light_of_what_recedes_is_redder_and_weaker_where_the_scene_says_so():
    flat = gf.catalogue.flat()
    camera = flat.camera([0, 0, 0], [1, 0, 0], fov=2)
    wall = (np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], float), [[0, 1, 2, 3]])
    plain, shifted = (
        gf.Scene(flat, redshift=r).add(wall, at=[2, 0, 0], emission=(1, 1, 1), velocity=[0.6, 0, "0*x"])
        for r in (False, True)
    )
    a, b = (scene.render(camera=camera, size=(8, 8), length=9) for scene in (plain, shifted))
    # Doppler: √((1 − 0.6)/(1 + 0.6)), and radiance goes as the fourth power.
    np.testing.assert_allclose(b["g"], 0.5, rtol=1e-3)
    assert (b["id"] == 1).all() and b.rgb.mean() < 0.2 * a.rgb.mean()
    hot = gf.Scene(flat).add(wall, at=[2, 0, 0], temperature=4000)
    red, green, blue = hot.render(camera=camera, size=(8, 8), length=9).rgb.mean((0, 1))
    assert red > green > blue > 0
    with pytest.raises(gf.InputError, match="redshift"):
        shifted.render(camera=camera, size=(8, 8), tracer="path", length=9)


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
    assert picture.tracer == "path" and picture.rgb.max() > 0 and "Z" in picture.layers and picture.samples == 4
    hasty = scene.render(camera=camera, size=(16, 9), spp=4096, tracer="path", length=8, seconds=1e-9)
    assert hasty.samples == 1


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


def test_a_pattern_is_the_sky_of_exits_and_a_colour_of_all_ends():
    bump = gf.catalogue.gaussian_bump()
    camera = bump.camera([2.5, 0, 0], [-1, 0, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        seen = gf.Scene(bump, sky="stars").render(camera=camera, size=(16, 9))
        assert seen.rgb.max() > 0
        short = gf.Scene(bump, sky=(0.25, 0.5, 1)).render(camera=camera, size=(16, 9), length=1)
    np.testing.assert_allclose(short.rgb, np.broadcast_to([0.25, 0.5, 1], short.rgb.shape), atol=1e-3)


def test_a_path_traced_picture_tells_no_shares_of_unfinished_paths(bump):
    camera = bump.camera({"c": 3.0}, [-1, 0, 0])
    scene = gf.Scene(bump, sky="grid")
    assert scene.render(camera=camera, size=(8, 8), tracer="path").unfinished == {}
    assert "length" in scene.render(camera=camera, size=(8, 8)).unfinished
