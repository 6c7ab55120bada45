"""Pictures in linear light with their layers."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _native

Layer = npt.NDArray[Any]


class Image:
    """A picture.

    Attributes
    ----------
    rgb : array (rows, columns, 3), float32
        Linear light, Rec. 709 primaries, row 0 at the top.
    layers : dict of arrays (rows, columns)
        By their names in EXR files: ``Z`` (arc length), ``P.X P.Y P.Z`` (chart point), ``N.X N.Y N.Z`` (normal),
        ``area``, ``id``, ``exit``, ``flagged``; ``image["Z"]`` is short for ``image.layers["Z"]``.
    tracer : str
        What followed the paths: ``exact``, ``table``, ``local`` or ``path``.
    flagged : float
        Share of samples that a table gave up on.
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

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Image:
        """Reads a PNG, HDR or EXR file, with its layers."""
        rgb, layers, notes = _native.read_picture(os.fspath(path))
        told = dict(notes)
        return cls(rgb, layers, tracer=told.get("tracer", ""), notes=told)

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
        """Writes a PNG, or an EXR with all layers, as the name ends."""
        whole = [(k, np.ascontiguousarray(v, np.uint32)) for k, v in self.layers.items() if v.dtype.kind in "iub"]
        real = [(k, np.ascontiguousarray(v, np.float32)) for k, v in self.layers.items() if v.dtype.kind == "f"]
        notes = {"tracer": self.tracer, **self.notes} if self.tracer else self.notes
        rgb = np.asarray(self.rgb, dtype=np.float32)
        _native.write_picture(os.fspath(path), rgb, real, whole, list(notes.items()))

    def _repr_png_(self) -> bytes:
        """Shows the picture in a notebook."""
        with tempfile.TemporaryDirectory(prefix="geofan-") as folder:
            path = Path(folder) / "picture.png"
            _native.write_picture(os.fspath(path), self.rgb, [], [], [])
            return path.read_bytes()

    def __repr__(self) -> str:
        width, height = self.size
        return f"<image {width}x{height} by {self.tracer or 'unknown'}; layers: {' '.join(self.layers) or 'none'}>"


class Comparison:
    """A view by table against exact integration, with errors and times of one run.

    Attributes
    ----------
    report : dict
        All numbers, by the names of ``geofan compare --json``.
    flip : array (rows, columns)
        FLIP of every pixel.
    table, exact, error, screen : Image
        Both pictures, the picture of FLIP and that of the screen error.
    """

    def __init__(self, report: dict[str, Any], text: str, flip: Layer, pictures: Mapping[str, Layer]) -> None:
        self.report = report
        self.flip = flip
        self.table = Image(pictures["table"], tracer="table")
        self.exact = Image(pictures["exact"], tracer="exact")
        self.error = Image(pictures["error"])
        self.screen = Image(pictures["mrad"])
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
            for title, image in (("table", self.table), ("exact", self.exact), ("FLIP", self.error))
        )
        return f"<table><tr>{cells}</tr></table><pre>{escape(self._text)}</pre>"
