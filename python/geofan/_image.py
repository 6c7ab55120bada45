"""Pictures in linear light with their layers."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native
from ._errors import InputError

Layer = npt.NDArray[Any]


class Image:
    """A picture.

    Attributes
    ----------
    rgb : array (rows, columns, 3), float32
        Linear light, Rec. 709 primaries, row 0 at the top.
    layers : dict of arrays (rows, columns)
        By their names in EXR files: ``Z`` (arc length), ``P.X P.Y P.Z`` (chart point), ``N.X N.Y N.Z`` (normal),
        ``area``, ``id``, ``exit``, ``flagged``, in glued spaces ``copy``, with ``redshift`` ``g``;
        ``image["Z"]`` is short for ``image.layers["Z"]``.
    tracer : str
        What followed the paths: ``exact``, ``table``, ``local`` or ``path``.
    flagged : float
        Share of samples that a table gave up on.
    unfinished : dict
        Of a picture that was drawn: shares of paths that end by their length or where the metric ends, and the length
        that would do, by the names of ``geofan render --json``. Empty of one by the tracer ``path``, which does not
        count them.
    samples : int
        Samples of a pixel.
    notes : dict of str
        What an EXR file says about itself.
    """

    def __init__(
        self,
        rgb: npt.ArrayLike,
        layers: Mapping[str, npt.ArrayLike] | None = None,
        *,
        tracer: str = "",
        flagged: float = 0.0,
        notes: Mapping[str, str] | None = None,
    ) -> None:
        self.rgb = np.asarray(rgb, dtype=np.float32)
        self.layers: dict[str, Layer] = {k: np.asarray(v) for k, v in (layers or {}).items()}
        self.tracer = tracer
        self.flagged = flagged
        self.notes = dict(notes or {})
        self.unfinished: dict[str, float | None] = {}
        self.samples = 0
        self._window: tuple[Any, float | None] = (None, None)

    @classmethod
    def _drawn(cls, drawn: Mapping[str, Any]) -> Image:
        """Takes a picture that was drawn."""
        notes = dict(drawn["notes"])
        made = cls(drawn["rgb"], drawn["layers"], tracer=drawn["tracer"], flagged=drawn["flagged"], notes=notes)
        made.unfinished = json.loads(drawn["unfinished"]) or {}
        made.samples = drawn["samples"]
        made._window = drawn["window"]
        return made

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Image:
        """Reads a PNG, HDR or EXR file, with its layers."""
        rgb, layers, notes, window = _native.read_picture(os.fspath(path))
        told = dict(notes)
        made = cls(rgb, layers, tracer=told.get("tracer", ""), notes=told)
        made._window = window
        return made

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.rgb.shape[1], self.rgb.shape[0]

    def __getitem__(self, layer: str) -> Layer:
        return self.layers[layer]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> npt.NDArray[Any]:
        """Returns the linear light, for numpy."""
        if dtype is None and not copy:
            return self.rgb
        return np.array(self.rgb, dtype=dtype)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a PNG, or an EXR with all layers, as the name ends.

        Raises
        ------
        InputError
            A layer holds what such files do not: complex numbers, or whole ones outside of 0 to 2³² − 1.
        """
        layers = {name: _checked(name, np.asarray(layer)) for name, layer in self.layers.items()}
        whole = [(k, np.ascontiguousarray(v, np.uint32)) for k, v in layers.items() if v.dtype.kind != "f"]
        real = [(k, np.ascontiguousarray(v, np.float32)) for k, v in layers.items() if v.dtype.kind == "f"]
        notes = {"tracer": self.tracer, **self.notes} if self.tracer else self.notes
        rgb = np.asarray(self.rgb, dtype=np.float32)
        if rgb.ndim != 3:
            raise InputError(f"rgb: a picture is (height, width, 3), this is {rgb.shape}", subject="rgb")
        _native.write_picture(os.fspath(path), rgb, real, whole, list(notes.items()), self._window)

    def _repr_png_(self) -> bytes:
        """Shows the picture in a notebook."""
        with tempfile.TemporaryDirectory(prefix="geofan-") as folder:
            path = Path(folder) / "picture.png"
            _native.write_picture(os.fspath(path), self.rgb, [], [], [], (None, None))
            return path.read_bytes()

    def __repr__(self) -> str:
        width, height = self.size
        return f"<image {width}x{height} by {self.tracer or 'unknown'}; layers: {' '.join(self.layers) or 'none'}>"


def _checked(name: str, layer: Layer) -> Layer:
    """Returns a layer; refuses what a file does not hold."""
    if layer.ndim != 2:
        raise InputError(f"{name}: a layer is (height, width), this is {layer.shape}", subject=name)
    if layer.dtype.kind not in "fiub":
        raise InputError(f"{name}: files hold no layers of {layer.dtype}", subject=name)
    if layer.dtype.kind in "iu" and layer.size and not 0 <= layer.min() <= layer.max() < 2**32:
        raise InputError(f"{name}: files hold whole numbers from 0 to 2^32 - 1", subject=name)
    return layer


class Comparison:
    """A view by table, or by straight lines, against exact integration, with errors and times of one run.

    Attributes
    ----------
    report : dict
        All numbers, by the names of ``geofan compare --json``.
    flip : array (rows, columns)
        FLIP of every pixel.
    approximate, exact, error, screen : Image
        The picture by the table (or by straight lines) and the exact one, the picture of FLIP and that of the screen
        error.
    """

    def __init__(
        self, report: dict[str, Any], text: str, flip: Layer, pictures: Mapping[str, Layer], *, tracer: str
    ) -> None:
        self.report = report
        self.flip = flip
        self.approximate = Image(pictures[tracer], tracer=tracer)
        self.exact = Image(pictures["exact"], tracer="exact")
        self.error = Image(pictures["error"])
        self.screen = Image(pictures["mrad"]) if "mrad" in pictures else self.error
        self._text = text

    @property
    def psnr(self) -> float:
        """PSNR of the table's picture against the exact one, dB; infinite if they are equal."""
        found = self.report["psnr"]
        return float("inf") if found is None else float(found)

    def __str__(self) -> str:
        return self._text

    def __repr__(self) -> str:
        return f"<comparison: PSNR {self.psnr:.1f} dB, FLIP {self.report['flip']:.5f}>"

    def _repr_html_(self) -> str:
        """Shows both pictures, their difference and the report in a notebook."""
        from base64 import b64encode

        def shown(title: str, image: Image) -> str:
            data = b64encode(image._repr_png_()).decode()
            source = f'<img alt="{title}" style="max-width:100%" src="data:image/png;base64,{data}">'
            return f"<td style='text-align:left'>{title}<br>{source}</td>"

        cells = "".join(
            shown(title, image)
            for title, image in ((self.approximate.tracer, self.approximate), ("exact", self.exact), ("FLIP", self.error))
        )
        return f"<table><tr>{cells}</tr></table><pre>{escape(self._text)}</pre>"
