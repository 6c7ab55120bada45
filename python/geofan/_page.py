"""Pages in which a scene is flown through: for browsers, and inside notebooks."""

from __future__ import annotations

import os
import shutil
import tempfile
from html import escape
from pathlib import Path
from typing import Any

from . import _native
from ._arrays import number
from ._bundle import Bundle
from ._camera import Camera
from ._errors import InputError, SceneError, check_kind
from ._manifold import Manifold
from ._scene import Scene

#: The viewer for browsers, compiled to WebAssembly.
_WASM = "geofan-web.wasm"


def page(
    scene: Scene | Manifold | str | os.PathLike[str],
    bundle: Bundle | None = None,
    out: str | os.PathLike[str] = "geofan.html",
    *,
    camera: Camera | None = None,
    length: float | None = None,
    wasm: str | os.PathLike[str] | None = None,
) -> Path:
    """Writes a scene as a page in which one looks around, without a server: what ``geofan view --page`` writes.

    Parameters
    ----------
    scene : Scene, Manifold or path
        What is shown; a bare manifold gets a first scene with globes.
    bundle : Bundle, optional
        The table to look paths up in; without, paths are exact.
    out : path
        One file, if it ends in ``.html`` or ``.htm``; else a folder for a static host.
    camera : Camera, optional
        Where one stands first, in a scene that was built in code. A scene file says it itself.
    length : float, optional
        How far exact paths are followed; the manifold's own length if it has one, else 10.
    wasm : path, optional
        The viewer for browsers. Without, the one in the package, the one that ``GEOFAN_WASM`` names, or the one beside
        the program ``geofan``.

    Returns `out`.
    """
    _made(scene, bundle, os.fspath(out), camera, length, wasm)
    return Path(out)


class View:
    """A scene inside a notebook, as :func:`view` returns it: it shows itself.

    Attributes
    ----------
    html : str
        The whole page.
    """

    def __init__(self, html: str, height: int) -> None:
        self.html = html
        self._height = height

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page."""
        Path(path).write_text(self.html, encoding="utf-8")

    def _repr_html_(self) -> str:
        """Shows the page in a frame of its own, which may run nothing but itself."""
        style = f"width:100%;height:{self._height}px;border:0"
        rights = "allow-scripts allow-downloads allow-pointer-lock"
        return f'<iframe sandbox="{rights}" style="{style}" srcdoc="{escape(self.html)}"></iframe>'

    def __repr__(self) -> str:
        return f"<view of {len(self.html) / 1e6:.1f} MB>"


def view(
    scene: Scene | Manifold | str | os.PathLike[str],
    bundle: Bundle | None = None,
    *,
    camera: Camera | None = None,
    length: float | None = None,
    height: int = 560,
    wasm: str | os.PathLike[str] | None = None,
) -> View:
    """Shows a scene in a notebook, to look around in: the page of :func:`page` inline.

    Parameters
    ----------
    height : int
        Of the frame, pixels.

    The others are those of :func:`page`. The page is in the notebook, and works wherever that is shown.
    """
    html = _made(scene, bundle, None, camera, length, wasm)
    assert html is not None
    return View(html, height)


def _made(
    scene: Any,
    bundle: Bundle | None,
    out: str | None,
    camera: Camera | None,
    length: float | None,
    wasm: str | os.PathLike[str] | None,
) -> str | None:
    """Makes a page of the files of a scene; writes files for what is in memory alone."""
    viewer = _viewer(wasm)
    far = None if length is None else number("length", length)
    if bundle is not None:
        check_kind("bundle", bundle, Bundle, "a Bundle")
    if camera is not None:
        check_kind("camera", camera, Camera, "a Camera")
    with tempfile.TemporaryDirectory(prefix="geofan-") as name:
        folder = Path(name)
        file, settings = _file_of(scene, camera, folder)
        table = None if bundle is None else _bundle_file(bundle, folder)
        return _native.page(file, table, far, settings, viewer, out)[1]


def _file_of(scene: Any, camera: Camera | None, folder: Path) -> tuple[str, list[tuple[str, float]]]:
    """Returns the file of a scene or manifold, and the parameters to load it with."""
    built = isinstance(scene, Scene) and scene._file is None
    if camera is not None and not built:
        raise SceneError("camera: a scene file and a first scene have cameras of their own", subject="camera")
    if isinstance(scene, Manifold):
        written = folder / "manifold.toml"
        written.write_text(scene.text, encoding="utf-8")
        return scene._path() or os.fspath(written), list(scene.parameters.items())
    if not isinstance(scene, Scene):
        return os.fspath(scene), []
    if scene._file is not None:
        return scene._path, scene._parameters
    if camera is None:
        raise SceneError("give a camera: Manifold.camera makes one", subject="camera")
    return os.fspath(scene._files(camera, folder)), list(scene.manifold.parameters.items())


def _bundle_file(bundle: Bundle, folder: Path) -> str:
    """Returns the file of a bundle; writes one for a bundle that is in memory alone, or whose file is another now."""
    kept = bundle._file()
    if kept is not None:
        return kept
    path = os.path.join(folder, "table.fan")
    bundle.save(path)
    return path


def _viewer(wasm: str | os.PathLike[str] | None) -> str:
    """Finds the viewer for browsers."""
    if wasm is not None:
        return os.fspath(wasm)
    named, program = os.environ.get("GEOFAN_WASM"), shutil.which("geofan")
    places = [Path(named)] if named else []
    places.append(Path(__file__).with_name(_WASM))
    if program is not None:
        places.append(Path(program).resolve().with_name(_WASM))
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        message = (
            f"there is no {_WASM}, the viewer for browsers, in {' or '.join(str(place) for place in places)}; "
            "build it in the sources of geofan by .ci/page.sh (it puts it into target/release) and give "
            "wasm=\"…/geofan-web.wasm\", or name it in GEOFAN_WASM"
        )
        raise InputError(message, subject="wasm")
    return os.fspath(found)
