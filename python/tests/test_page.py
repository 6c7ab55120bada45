"""Pages: those of the command line, inside notebooks too."""

import html
import io
import json
import os
import re

import geofan as gf
import numpy as np
import pytest
from conftest import SCENES


@pytest.fixture
def wasm(tmp_path):
    """Not a viewer, but it begins like one: a page is written, whatever it is."""
    path = tmp_path / "any.wasm"
    path.write_bytes(b"\0asm\x01\0\0\0")
    return path


def test_a_page_has_the_bytes_of_the_command_line_s(command, bump, table, wasm, tmp_path):
    (tmp_path / "bump.toml").write_text(bump.text)
    (tmp_path / "scene.toml").write_text(
        'manifold = "bump.toml"\n[camera]\nat = [2.5, 0, 0]\nlook = [-1, 0, 0]\nup = [0, 0, 1]\n'
        '[sky]\nsky = { pattern = "grid" }\n'
    )
    line = ("--bundle", table.path, "--wasm", wasm)
    told = command("view", tmp_path / "scene.toml", "--page", tmp_path / "told.html", *line)
    found = gf.page(gf.Scene(tmp_path / "scene.toml"), table, tmp_path / "mine.html", wasm=wasm)
    assert found.read_bytes() == (tmp_path / "told.html").read_bytes() and found.stat().st_size == told["bytes"]
    inline = gf.view(tmp_path / "scene.toml", table, wasm=wasm)
    # A file is in UTF-16, which carries more in a byte; a notebook's texts are in UTF-8. Its head is the same.
    head = found.read_text(encoding="utf-16").split("<style", 1)[0]
    assert inline.html.startswith(head) and "<title>Bump" in head
    frame = re.fullmatch(r'<iframe sandbox="([^"]*)" [^>]*srcdoc="([^"]*)"></iframe>', inline._repr_html_())
    assert frame is not None and html.unescape(frame[2]) == inline.html and "same-origin" not in frame[1]
    inline.save(tmp_path / "saved.html")
    assert (tmp_path / "saved.html").read_text(encoding="utf-8") == inline.html


def test_a_bundle_whose_file_is_another_now_is_shown_itself(bump, table, wasm, tmp_path):
    path = tmp_path / "table.fan"
    path.write_bytes(table.to_bytes())
    kept = gf.Bundle(path)
    shown = gf.view(bump, kept, wasm=wasm).html
    other = bump.bake(5.0, certify_rays=500)
    for now in (other.to_bytes(), b"no bundle"):
        path.write_bytes(now)
        assert gf.view(bump, kept, wasm=wasm).html == shown


def test_files_called_as_a_manifold_are_not_its_own(wasm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "metric").write_bytes(b"\xff\xfe\x00")
    for name in ("metric", "m" * 3000):
        flat = gf.Manifold.metric(conformal=1, name=name, length=9)
        assert "<html" in gf.view(flat, wasm=wasm).html


def test_scenes_in_memory_and_bare_manifolds_have_pages(bump, table, wasm, tmp_path):
    triangle = (np.eye(3), [[0, 1, 2]])
    scene = gf.Scene(bump.set(), sky="grid").add(triangle, at=[1, 0, 0], color=(1, 0, 0)).light([0, 0, 2])
    camera = bump.camera([2.5, 0, 0], [-1, 0, 0], fov=50)
    again = gf.Bundle.from_bytes(table.to_bytes())
    site = gf.page(scene, again, tmp_path / "site", camera=camera, wasm=wasm)
    assert {path.name for path in site.iterdir()} > {"index.html", "viewer.js", "space.lzma"}
    assert "Bump · geofan" in (site / "index.html").read_text()
    # Its files are those that the scene was made of: read back, they draw the same picture.
    folder = tmp_path / "files"
    folder.mkdir()
    written = gf.Scene(scene._files(camera, folder)).render(size=(40, 30))
    np.testing.assert_allclose(written.rgb, scene.render(camera=camera, size=(40, 30)).rgb, atol=1e-5)
    assert "<title>Bump" in gf.view(bump, wasm=wasm, length=8).html


def test_what_has_no_page_says_why(bump, table, wasm, tmp_path, monkeypatch):
    scene = gf.Scene(bump, sky="grid")
    with pytest.raises(gf.SceneError, match="camera"):
        gf.view(scene, wasm=wasm)
    with pytest.raises(gf.SceneError, match="of their own"):
        gf.view(bump, camera=bump.camera([2, 0, 0], [-1, 0, 0]), wasm=wasm)
    with pytest.raises(gf.InputError, match="another manifold"):
        gf.view(SCENES / "s3-lamp.toml", table, wasm=wasm)
    with pytest.raises(gf.InputError, match="WebAssembly"):
        gf.view(bump, wasm=__file__)
    monkeypatch.setattr("geofan._page._WASM", "no-such-viewer.wasm")
    monkeypatch.delenv("GEOFAN_WASM", raising=False)
    with pytest.raises(gf.InputError, match="page.sh"):
        gf.view(bump)


def test_the_viewer_inside_of_a_notebook_draws(bump, tmp_path):
    """Opens a notebook's output in a browser, where there is one."""
    playwright, pillow = pytest.importorskip("playwright.sync_api"), pytest.importorskip("PIL.Image")
    browser_file = os.environ.get("GEOFAN_CHROMIUM")
    if browser_file is None:
        pytest.skip("GEOFAN_CHROMIUM names no browser")
    try:
        shown = gf.view(bump)
    except gf.InputError as missing:
        pytest.skip(str(missing))
    page_file = tmp_path / "output.html"
    page_file.write_text(f"<!doctype html><body>{shown._repr_html_()}")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_file, args=["--no-sandbox"])
        page = browser.new_page()
        failures = []
        page.on("pageerror", lambda error: failures.append(str(error)))
        page.goto(page_file.as_uri())
        canvas = page.frame_locator("iframe").locator("#picture")
        canvas.wait_for(timeout=60_000)
        pictures = []
        for _ in range(120):
            page.wait_for_timeout(500)
            pictures.append(np.asarray(pillow.open(io.BytesIO(canvas.screenshot())).convert("RGB")))
            if failures or len(np.unique(pictures[-1].reshape(-1, 3), axis=0)) > 500:
                break
        assert not failures, json.dumps(failures)
        # Stars, letters of the sky's grid and shaded globes; not one colour and some buttons.
        assert len(np.unique(pictures[-1].reshape(-1, 3), axis=0)) > 500
        if folder := os.environ.get("GEOFAN_SHOTS"):
            pillow.fromarray(pictures[-1]).save(os.path.join(folder, "notebook.png"))
        browser.close()
