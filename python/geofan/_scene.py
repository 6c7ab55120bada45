"""Scenes: what stands in a space, and pictures of it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native, _toml
from ._arrays import Floats, Integers, count, counts, floats, integers, items, number, vector
from ._bundle import Bundle
from ._camera import Camera
from ._errors import InputError, SceneError, check_kind, warn
from ._expressions import text_of
from ._image import Comparison, Image
from ._manifold import Manifold, _settings
from ._progress import Progress, teller

#: The built-in patterns of skies.
_PATTERNS = ("grid", "stars")

#: The most reflections of light that the path tracer counts.
_MOST_BOUNCES = 2**32 - 1


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
        a linear colour, or the path of an equirectangular picture. A colour is also that of paths that end by their
        length (``"length"``).
    redshift : bool
        Of a scene built in code: whether light is weighed with what happens to its frequency on the way.

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
        redshift: bool = False,
    ) -> None:
        self._objects: list[str] = []
        self._lights: list[str] = []
        self._meshes: list[tuple[str, Floats, Integers, tuple[float, ...], tuple[float, ...]]] = []
        self._skies: dict[str, Any] = {}
        self._staged: _native.Stage | None = None
        self._file: _native.Stage | None = None
        self._redshift = bool(redshift)
        if not isinstance(source, Manifold):
            self._path, self._parameters = os.path.abspath(os.fspath(source)), _settings(parameters)
            self._file = _native.Stage.load(os.fspath(source), self._parameters)
            manifold = self._file.manifold
            self.manifold = Manifold._of(manifold, os.path.abspath(manifold.source[0]))
            if sky is not None or redshift:
                raise SceneError("sky, redshift: a scene from a file does not change", subject="sky")
            warn(self._file.warnings)
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
        crease: float | None = None,
        velocity: Sequence[Any] | None = None,
        temperature: Any = None,
    ) -> Scene:
        """Adds an object; returns the scene.

        Parameters
        ----------
        mesh : path, (vertices, faces), trimesh or meshio mesh
            An OBJ, PLY or glTF file with its materials; or arrays (n, 3) of points in the mesh's unit and (m, 3 or 4) of their
            numbers; or an object that has them.
        at : array (3,)
            Chart point of the mesh's origin.
        scale : float
            Length in the metric of the mesh's unit.
        rotate : (axis, degrees), optional
            Turn in the standard frame at `at`.
        placement : {"linear", "exponential", "chart"}
            Right to first order, for small objects; or exact along rays from the origin, for larger ones; or a shape
            of the chart, whatever the metric.
        color, emission : three numbers
            Linear diffuse reflectance, and radiance given off, of a mesh that is no file.
        crease : float, optional
            Edges that turn by more than this are sharp where the mesh has no normals, degrees; 30 if not given.
        velocity : three expressions, optional
            ``dx/dt`` in chart components: what it does to the light that the object sends. It stays where it is.
        temperature : expression, optional
            How hot it is, kelvin, if it glows as a black body.
        """
        self._built("add")
        name = os.path.abspath(os.fspath(mesh)) if _is_path(mesh) else f"geofan-mesh-{len(self._meshes) + 1}.obj"
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
            axis, degrees = items("rotate", rotate, 2)
            entry["rotate"] = {"axis": vector("rotate", axis), "degrees": number("rotate", degrees)}
        if crease is not None:
            entry["crease"] = number("crease", crease)
        if velocity is not None:
            entry["velocity"] = [text_of(f"velocity[{i}]", x) for i, x in enumerate(velocity)]
        if temperature is not None:
            entry["temperature"] = text_of("temperature", temperature)
        self._objects.append(_entry("object", entry))
        self._staged = None
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
        given = floats("intensity", intensity)
        if given.shape not in ((), (1,), (3,)):
            raise InputError("intensity: one number or three are needed", subject="intensity")
        several = np.broadcast_to(given, (3,))
        entry = {"kind": "point", "at": vector("at", at), "intensity": several.tolist()}
        self._lights.append(_entry("light", entry))
        self._staged = None
        return self

    def sky(self, sky: Any) -> Scene:
        """Says what is seen through exits; returns the scene. See the class for what `sky` may be."""
        self._built("sky")
        if not isinstance(sky, Mapping):
            # Paths that end by their length have no direction in a sky, only a colour.
            of_one_colour = "color" in _sky_entry("all", sky)
            ways = (*self.manifold.exits, "length") if of_one_colour else self.manifold.exits
            sky = dict.fromkeys(ways, sky)
        self._skies |= {str(name): _sky_entry(str(name), entry) for name, entry in sky.items()}
        self._staged = None
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
        """What was mended or left out of meshes while loading, and is warned of then."""
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
        size: tuple[int, int] | None = None,
        crop: tuple[int, int, int, int] | None = None,
        spp: int = 1,
        tracer: str | None = None,
        length: float | None = None,
        error: float = 0.5,
        tolerance: float = 1e-8,
        layers: bool = True,
        seed: int = 0,
        bounces: int | None = None,
        seconds: float | None = None,
        progress: Progress = False,
    ) -> Image:
        """Draws a picture.

        Parameters
        ----------
        bundle : Bundle, optional
            The table to look paths up in; it must be of the scene's manifold.
        camera : Camera or str, optional
            Where it is seen from: a camera, or the name of a view of a scene file; its main camera without.
        size : (int, int), optional
            Columns and rows, of both eyes together; 640 × 360 if not given, or what suits the projection.
        crop : four ints, optional
            Draw only this part, in pixels: its first column and row, its columns and rows.
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
        seed, bounces, seconds : int, int, float
            Of the path tracer: its noise, how often light may be reflected, and after which time it ends although
            not all samples are done.
        progress : bool or function
            As in :meth:`Manifold.bake`; the work is ``light``, ``picture`` or ``samples``.

        A view that is black in parts because paths are too short, and the like, is warned of
        (:class:`GeofanWarning`); ``image.unfinished`` has the numbers.
        """
        request = self._request(bundle, camera, size, crop, spp, error, tolerance, length)
        seen = camera._native if isinstance(camera, Camera) else None
        stage, told = self._stage(), teller(progress)
        if tracer is not None and not isinstance(tracer, str):
            raise InputError(f"tracer: {tracer!r} is no name", subject="tracer")
        if tracer == "path":
            if bundle is not None:
                raise InputError("tracer: `path` follows exact paths, without a bundle", subject="tracer")
            most = None if bounces is None else count("bounces", bounces, _MOST_BOUNCES)
            until = None if seconds is None else number("seconds", seconds)
            drawn = stage.path_trace(seen, request, count("seed", seed), most, until, layers, told)
        else:
            table = None if bundle is None else bundle._native
            drawn = stage.render(seen, request, tracer, table, _light_file(bundle), layers, told)
        warn(drawn["warnings"])
        return Image._drawn(drawn)

    def compare(
        self,
        bundle: Bundle | None = None,
        *,
        camera: Camera | str | None = None,
        size: tuple[int, int] | None = None,
        crop: tuple[int, int, int, int] | None = None,
        spp: int = 1,
        length: float | None = None,
        error: float = 0.5,
        tolerance: float = 1e-8,
        frames: int = 20,
    ) -> Comparison:
        """Holds the picture by a table, or that by straight lines of the chart, against the exact one.

        Parameters
        ----------
        bundle : Bundle, optional
            The table; without, straight lines of the chart take its place.
        frames : int
            From how many cameras, moving and turning, the table's frame is drawn; its times are medians.

        The others are those of :meth:`render`. Ctrl-C takes effect when the comparison has ended.
        """
        request = self._request(bundle, camera, size, crop, spp, error, tolerance, length)
        seen = camera._native if isinstance(camera, Camera) else None
        stage = self._stage()
        if bundle is None:
            return Comparison(*_read(stage.compare_local(seen, request)), tracer="local")
        if length is not None:
            raise InputError("length: the paths of a bundle have their length", subject="length")
        found = stage.compare(seen, request, bundle._native, _light_file(bundle), count("frames", frames))
        return Comparison(*_read(found), tracer="table")

    def __repr__(self) -> str:
        objects = "from a file" if self._file is not None else f"{len(self._objects)} objects"
        return f"<scene in {self.manifold.name!r}: {objects}>"

    def _built(self, what: str) -> None:
        """Refuses to change a scene that is a file."""
        if self._file is not None:
            raise SceneError(f"{what}: a scene from a file does not change", subject=what)

    def _request(
        self,
        bundle: Bundle | None,
        camera: Camera | str | None,
        size: tuple[int, int] | None,
        crop: tuple[int, int, int, int] | None,
        spp: int,
        error: float,
        tolerance: float,
        length: float | None,
    ) -> dict[str, Any]:
        """Returns what all pictures need to be told."""
        if bundle is not None:
            check_kind("bundle", bundle, Bundle, "a Bundle")
        if camera is not None:
            check_kind("camera", camera, (str, Camera), "a Camera or the name of a view")
        if isinstance(camera, Camera):
            if camera.manifold.differences(self.manifold):
                raise InputError("camera: it is in another manifold than the scene", subject="camera")
        elif self._file is None:
            raise SceneError("give a camera: Manifold.camera makes one", subject="camera")
        return {
            "view": camera if isinstance(camera, str) else None,
            "size": None if size is None else tuple(counts("size", size, 2)),
            "crop": None if crop is None else counts("crop", crop, 4),
            "spp": count("spp", spp),
            "error": number("error", error),
            "tolerance": number("tolerance", tolerance),
            "length": None if length is None else number("length", length),
        }

    def _stage(self) -> _native.Stage:
        """Returns the scene with its meshes placed."""
        if self._file is not None:
            return self._file
        if self._staged is None:
            text = self._written("at = [0.0, 0.0, 0.0]\nlook = [1.0, 0.0, 0.0]\nup = [0.0, 0.0, 1.0]\n")
            self._staged = _native.Stage.parse(text, "", self.manifold._native, self._meshes)
            warn(self._staged.warnings)
        return self._staged

    def _written(self, camera: str | None, manifold: str | None = None) -> str:
        """Writes a scene file."""
        text = f"manifold = {_toml.string(manifold or self.manifold.name)}\n"
        if self._redshift:
            text += "redshift = true\n"
        if camera is not None:
            text += f"\n[camera]\n{camera}"
        return text + "".join(self._objects + self._lights) + _toml.table("sky", self._skies)

    def _files(self, camera: Camera, folder: Path) -> Path:
        """Writes the scene with all that is in memory alone as files into `folder`; returns the scene's."""
        (folder / "manifold.toml").write_text(self.manifold.text, encoding="utf-8")
        for name, vertices, faces, color, emission in self._meshes:
            material = Path(name).with_suffix(".mtl").name
            lines = [f"mtllib {material}", "usemtl made"]
            lines += ["v " + " ".join(repr(float(x)) for x in vertex) for vertex in vertices]
            lines += ["f " + " ".join(str(int(i) + 1) for i in face) for face in faces]
            (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
            light = (" ".join(repr(float(x)) for x in three) for three in (color, emission))
            (folder / material).write_text("newmtl made\nKd {}\nKe {}\n".format(*light), encoding="utf-8")
        path = folder / "scene.toml"
        path.write_text(self._written(camera.text, self.manifold._path() or "manifold.toml"), encoding="utf-8")
        return path

    def __reduce__(self) -> tuple[Any, ...]:
        if self._file is not None:
            raise TypeError("a scene from a file is not pickled: send its path")
        return _rebuilt, (
            self.manifold,
            self._redshift,
            self._objects,
            self._lights,
            self._meshes,
            self._skies,
        )


def _rebuilt(manifold: Manifold, redshift: bool, objects: Any, lights: Any, meshes: Any, skies: Any) -> Scene:
    scene = Scene(manifold, redshift=redshift)
    # A copy in this process is handed the very lists of the original.
    scene._objects, scene._lights, scene._meshes = list(objects), list(lights), list(meshes)
    scene._skies = dict(skies)
    return scene


def _read(found: tuple[str, str, Any, Any]) -> tuple[dict[str, Any], str, Any, Any]:
    """Reads the report of a comparison."""
    return (json.loads(found[0]), *found[1:])


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
        corners = np.asarray(faces)
    except (TypeError, ValueError):
        message = "mesh: give a path, (vertices, faces) as arrays, or a trimesh or meshio mesh"
        raise InputError(message, subject="mesh") from None
    if points.ndim != 2 or corners.ndim != 2:
        raise InputError("mesh: vertices are an array (n, 3), faces (m, 3)", subject="mesh")
    return points, integers("mesh: faces", corners)


def _light_file(bundle: Bundle | None) -> str | None:
    """Returns the bundle beside which the light of lamps is kept."""
    return None if bundle is None or bundle.path is None else os.fspath(bundle.path)
