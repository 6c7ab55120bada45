"""Cameras that live in a space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._arrays import Floats, count, number

if TYPE_CHECKING:
    from ._manifold import Manifold


class Camera:
    """A camera in a manifold, made by :meth:`Manifold.camera` or :meth:`Scene.camera`.

    It does not change: moves and turns return other cameras. A camera that moves follows a geodesic, and its axes are
    transported in parallel: moved around a loop it comes back turned by the curvature inside.
    """

    def __init__(self, manifold: Manifold, native: _native.Camera) -> None:
        self.manifold = manifold
        self._native = native

    @property
    def at(self) -> Floats:
        """Where it is: chart point."""
        return np.array(self._native.at)

    @property
    def fov(self) -> float:
        """Horizontal angle of view, degrees."""
        return self._native.fov

    @property
    def look(self) -> Floats:
        """Unit vector of the view, in the standard frame."""
        return -np.array(self._native.rotation[2])

    @property
    def up(self) -> Floats:
        """Unit vector of the picture's upward direction, in the standard frame."""
        return np.array(self._native.rotation[1])

    @property
    def right(self) -> Floats:
        """Unit vector of the picture's right, in the standard frame."""
        return np.array(self._native.rotation[0])

    @property
    def axes(self) -> Floats:
        """Three vectors (3, 3) in chart components: right, up and back."""
        return np.array(self._native.axes)

    def moved(self, right: float = 0.0, up: float = 0.0, forward: float = 0.0) -> Camera:
        """Returns the camera moved along a geodesic.

        Parameters
        ----------
        right, up, forward : float
            Lengths in the metric, along its own axes. It stops where the space ends.
        """
        by = (number("right", right), number("up", up), number("forward", forward))
        return Camera(self.manifold, self._native.moved(by)[0])

    def turned(self, right: float = 0.0, up: float = 0.0, roll: float = 0.0) -> Camera:
        """Returns the camera turned.

        Parameters
        ----------
        right, up, roll : float
            Angles in degrees: to the right, then upwards, then clockwise as it sees it.
        """
        by = (number("right", right), number("up", up), number("roll", roll))
        return Camera(self.manifold, self._native.turned(by))

    def zoomed(self, fov: float) -> Camera:
        """Returns the camera with another horizontal angle of view, in degrees."""
        return Camera(self.manifold, self._native.zoomed(number("fov", fov)))

    def directions(self, size: tuple[int, int]) -> Floats:
        """Returns the directions of the middles of pixels, in the standard frame.

        Parameters
        ----------
        size : (int, int)
            Columns and rows of the picture.

        Returns
        -------
        array (rows, columns, 3)
            From the upper left pixel on; unit vectors.
        """
        width, height = count("size", size[0]), count("size", size[1])
        return self._native.directions((width, height)).reshape(height, width, 3)

    def __repr__(self) -> str:
        at, look = (np.array2string(x, precision=6) for x in (self.at, self.look))
        return f"<camera at {at} looking {look}, {self.fov:g}° wide>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.manifold, self.at, self.look, self.up, self.fov)


def _rebuilt(manifold: Manifold, at: Floats, look: Floats, up: Floats, fov: float) -> Camera:
    return manifold.camera(at, look, up, fov=fov)
