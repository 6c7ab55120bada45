"""Scenes: what stands in a space, and pictures of it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native, _toml
from ._arrays import Floats, Integers, count, number, vector
from ._bundle import Bundle
from ._camera import Camera
from ._errors import InputError, SceneError
from ._image import Comparison, Image
from ._manifold import Manifold, _settings
from ._progress import Progress, teller

#: The built-in patterns of skies.
_PATTERNS = ("grid", "stars")


class Scene:
    """Objects, lights and skies in a manifold.

    Parameters
    ----------
    source : path, str or Manifold
        A scene file, or the manifold of a scene that is built in code.
    parameters : mapping, optional
        Values that replace those of the scene file's manifold.
    sky : str, sequence or mapping, optional
        Of a scene built in code: what is seen through all exits, or by the names of exits: ``"grid"``, ``"stars"``,
        a linear colour, or the path of an equirectangular picture.

    Raises
    ------
    SceneError, ManifoldError
        A file cannot work; ``line``, ``column`` and ``hint`` say where and what to do.

    >>> import geofan as gf
    >>> scene = gf.Scene(gf.catalogue.s3(), sky={"length": (0.1, 0.1, 0.2)})
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | Manifold,
        *,
        parameters: Mapping[str, float] | None = None,
        sky: Any = None,
    ) -> None:
        self._objects: list[str] = []
        self._lights: list[str] = []
        self._meshes: list[tuple[str, Floats, Integers, tuple[float, ...], tuple[float, ...]]] = []
        self._skies: dict[str, Any] = {}
        self._stages: dict[tuple[Any, ...], _native.Stage] = {}
        self._file: _native.Stage | None = None
        if not isinstance(source, Manifold):
            self._file = _native.Stage.load(os.fspath(source), _settings(parameters))
            self.manifold = Manifold._of(self._file.manifold)
            return
        if parameters:
            raise InputError("parameters: use Manifold.set", subject="parameters")
        self.manifold = source
        if sky is not None:
            self.sky(sky)

    def add(
        self,
        mesh: Any,
        at: npt.ArrayLike,
        *,
        scale: float = 1.0,
        rotate: tuple[npt.ArrayLike, float] | None = None,
        placement: str = "linear",
        color: Sequence[float] = (0.7, 0.7, 0.7),
        emission: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> Scene:
        """Adds an object; returns the scene.

        Parameters
        ----------
        mesh : path, (vertices, faces), trimesh or meshio mesh
            An OBJ file with its materials; or arrays (n, 3) of points in the mesh's unit and (m, 3 or 4) of their
            numbers; or an object that has them.
        at : array (3,)
            Chart point of the mesh's origin.
        scale : float
            Length in the metric of the mesh's unit.
        rotate : (axis, degrees), optional
            Turn in the standard frame at `at`.
        placement : {"linear", "exponential"}
            Right to first order, for small objects; or exact along rays from the origin, for larger ones.
        color, emission : three numbers
            Linear diffuse reflectance, and radiance given off, of a mesh that is no file.
        """
        self._built("add")
        name = os.path.abspath(os.fspath(mesh)) if _is_path(mesh) else f"mesh {len(self._meshes) + 1}"
        if not _is_path(mesh):
            vertices, faces = _arrays_of(mesh)
            colors = (_three("color", color), _three("emission", emission))
            self._meshes.append((name, vertices, faces, *colors))
        entry: dict[str, Any] = {
            "mesh": name,
            "at": vector("at", at),
            "scale": number("scale", scale),
            "placement": placement,
        }
        if rotate is not None:
            entry["rotate"] = {"axis": vector("rotate", rotate[0]), "degrees": number("rotate", rotate[1])}
        self._objects.append(_entry("object", entry))
        self._stages.clear()
        return self

    def light(self, at: npt.ArrayLike, intensity: Sequence[float] | float = 10.0) -> Scene:
        """Adds a point light; returns the scene.

        Parameters
        ----------
        at : array (3,)
            Its chart point.
        intensity : float or three numbers
            Linear red, green and blue per unit solid angle.
        """
        self._built("light")
        several = np.broadcast_to(np.asarray(intensity, dtype=np.float64), (3,))
        entry = {"kind": "point", "at": vector("at", at), "intensity": several.tolist()}
        self._lights.append(_entry("light", entry))
        self._stages.clear()
        return self

    def sky(self, sky: Any) -> Scene:
        """Says what is seen through exits; returns the scene. See the class for what `sky` may be."""
        self._built("sky")
        if not isinstance(sky, Mapping):
            sky = dict.fromkeys((*self.manifold.exits, "length"), sky)
        self._skies |= {str(name): _sky_entry(str(name), entry) for name, entry in sky.items()}
        self._stages.clear()
        return self

    def camera(self, view: str | None = None) -> Camera:
        """Returns the main camera of a scene file, or the one of its view of this name."""
        if self._file is None:
            raise SceneError("a scene built in code has no camera: see Manifold.camera", subject="camera")
        return Camera(self.manifold, self._file.camera(view))

    @property
    def views(self) -> tuple[str, ...]:
        """The names of a scene file's further views."""
        return () if self._file is None else tuple(self._file.views)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was mended or left out of meshes while loading."""
        return tuple(self._stage().warnings)

    @property
    def text(self) -> str:
        """The text of the scene file; of a scene built in code without a camera."""
        return self._file.text if self._file is not None else self._written(None)

    def render(
        self,
        bundle: Bundle | None = None,
        *,
        camera: Camera | str | None = None,
        size: tuple[int, int] = (640, 360),
        spp: int = 1,
        tracer: str | None = None,
        length: float | None = None,
        error: float = 0.5,
        tolerance: float = 1e-8,
        layers: bool = True,
        seed: int = 0,
        bounces: int | None = None,
        progress: Progress = False,
    ) -> Image:
        """Draws a picture.

        Parameters
        ----------
        bundle : Bundle, optional
            The table to look paths up in; it must be of the scene's manifold.
        camera : Camera or str, optional
            Where it is seen from: a camera, or the name of a view of a scene file; its main camera without.
        size : (int, int)
            Columns and rows.
        spp : int
            Samples for each pixel.
        tracer : {"table", "exact", "local", "path"}, optional
            What follows the paths: the table with a bundle, exact integration without; straight lines of the chart;
            or light by Monte Carlo along exact paths.
        length : float, optional
            How far exact paths are followed; the manifold's own length if it has one.
        error : float
            Largest error of interpolation between looked-up paths, mrad.
        tolerance : float
            Local tolerance of exact paths, radians.
        layers : bool
            Whether to make the layers of an EXR file, too.
        seed, bounces : int
            Of the path tracer: its noise, and how often light may be reflected.
        progress : bool or function
            As in :meth:`Manifold.bake`.
        """
        request = self._request(camera, size, spp, error, tolerance, length)
        seen = camera._native if isinstance(camera, Camera) else None
        stage, told = self._stage(seen is not None), teller(progress)
        if tracer == "path":
            if bundle is not None:
                raise InputError("tracer: `path` follows exact paths, without a bundle", subject="tracer")
            most = None if bounces is None else count("bounces", bounces)
            drawn = stage.path_trace(seen, request, count("seed", seed), most, layers, told)
        else:
            table = None if bundle is None else bundle._native
            drawn = stage.render(seen, request, tracer, table, _light_file(bundle), layers, told)
        rgb, found, name, flagged = drawn
        return Image(rgb, found, tracer=name, flagged=flagged, notes={"manifold": self.manifold.name})

    def compare(
        self,
        bundle: Bundle,
        *,
        camera: Camera | str | None = None,
        size: tuple[int, int] = (640, 360),
        spp: int = 1,
        error: float = 0.5,
        tolerance: float = 1e-8,
        frames: int = 20,
    ) -> Comparison:
        """Holds the picture by a table against the exact one.

        Parameters
        ----------
        frames : int
            From how many cameras, moving and turning, the table's frame is drawn; its times are medians.

        The others are those of :meth:`render`.
        """
        request = self._request(camera, size, spp, error, tolerance, None)
        seen = camera._native if isinstance(camera, Camera) else None
        stage = self._stage(seen is not None)
        report, text, flip, pictures = stage.compare(
            seen, request, bundle._native, _light_file(bundle), count("frames", frames)
        )
        return Comparison(json.loads(report), text, flip, pictures)

    def __repr__(self) -> str:
        objects = "from a file" if self._file is not None else f"{len(self._objects)} objects"
        return f"<scene in {self.manifold.name!r}: {objects}>"

    def _built(self, what: str) -> None:
        """Refuses to change a scene that is a file."""
        if self._file is not None:
            raise SceneError(f"{what}: a scene from a file does not change", subject=what)

    def _request(
        self,
        camera: Camera | str | None,
        size: tuple[int, int],
        spp: int,
        error: float,
        tolerance: float,
        length: float | None,
    ) -> dict[str, Any]:
        """Returns what all pictures need to be told."""
        if isinstance(camera, Camera):
            if camera.manifold.differences(self.manifold):
                raise InputError("camera: it is in another manifold than the scene", subject="camera")
        elif self._file is None:
            raise SceneError("give a camera: Manifold.camera makes one", subject="camera")
        return {
            "view": camera if isinstance(camera, str) else None,
            "size": (count("size", size[0]), count("size", size[1])),
            "spp": count("spp", spp),
            "error": number("error", error),
            "tolerance": number("tolerance", tolerance),
            "length": None if length is None else number("length", length),
        }

    def _stage(self, _seen: bool = False) -> _native.Stage:
        """Returns the scene with its meshes placed."""
        if self._file is not None:
            return self._file
        key = (len(self._objects), len(self._lights))
        if key not in self._stages:
            text = self._written("at = [0.0, 0.0, 0.0]\nlook = [1.0, 0.0, 0.0]\nup = [0.0, 0.0, 1.0]\n")
            folder = os.getcwd()
            self._stages[key] = _native.Stage.parse(text, folder, self.manifold._native, self._meshes)
        return self._stages[key]

    def _written(self, camera: str | None) -> str:
        """Writes a scene file."""
        text = f"manifold = {_toml.string(self.manifold.name)}\n"
        if camera is not None:
            text += f"\n[camera]\n{camera}"
        return text + "".join(self._objects + self._lights) + _toml.table("sky", self._skies)

    def __reduce__(self) -> tuple[Any, ...]:
        if self._file is not None:
            raise TypeError("a scene from a file is not pickled: send its path")
        return _rebuilt, (self.manifold, self._objects, self._lights, self._meshes, self._skies)


def _rebuilt(manifold: Manifold, objects: Any, lights: Any, meshes: Any, skies: Any) -> Scene:
    scene = Scene(manifold)
    scene._objects, scene._lights, scene._meshes, scene._skies = objects, lights, meshes, skies
    return scene


def _is_path(mesh: Any) -> bool:
    return isinstance(mesh, (str, os.PathLike))


def _entry(title: str, entry: Mapping[str, Any]) -> str:
    """Writes an entry of an array of tables."""
    lines = "".join(f"{_toml.key(k)} = {_toml.value(k, v)}\n" for k, v in entry.items())
    return f"\n[[{title}]]\n{lines}"


def _sky_entry(name: str, entry: Any) -> dict[str, Any]:
    """Returns what a scene file says of a sky."""
    if isinstance(entry, Mapping):
        return dict(entry)
    if isinstance(entry, str) and entry in _PATTERNS:
        return {"pattern": entry}
    if _is_path(entry):
        return {"image": os.path.abspath(os.fspath(entry))}
    return {"color": list(_three(f"sky.{name}", entry))}


def _three(name: str, values: Sequence[float]) -> tuple[float, float, float]:
    """Returns three numbers that are not negative."""
    a, b, c = vector(name, values)
    if not min(a, b, c) >= 0.0 or not np.isfinite((a, b, c)).all():
        raise InputError(f"{name}: three finite numbers from 0 on are needed", subject=name)
    return a, b, c


def _arrays_of(mesh: Any) -> tuple[Floats, Integers]:
    """Returns vertices and faces of a pair of arrays, or of a trimesh or meshio mesh."""
    if hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        mesh = (mesh.vertices, mesh.faces)
    elif hasattr(mesh, "points") and hasattr(mesh, "cells_dict"):
        cells = mesh.cells_dict
        kind = "triangle" if "triangle" in cells else "quad"
        if kind not in cells:
            raise InputError("mesh: it has neither triangles nor quads", subject="mesh")
        mesh = (mesh.points, cells[kind])
    try:
        vertices, faces = mesh
        points = np.ascontiguousarray(vertices, dtype=np.float64)
        corners = np.ascontiguousarray(faces, dtype=np.int64)
    except (TypeError, ValueError):
        message = "mesh: give a path, (vertices, faces) as arrays, or a trimesh or meshio mesh"
        raise InputError(message, subject="mesh") from None
    if points.ndim != 2 or corners.ndim != 2:
        raise InputError("mesh: vertices are an array (n, 3), faces (m, 3)", subject="mesh")
    return points, corners


def _light_file(bundle: Bundle | None) -> str | None:
    """Returns the bundle beside which the light of lamps is kept."""
    return None if bundle is None or bundle.path is None else os.fspath(bundle.path)
