"""Cameras that live in a space."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._arrays import Floats, counts, number

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

    @classmethod
    def _read(cls, manifold: Manifold, text: str) -> Camera:
        """Makes a camera of the lines of a scene file's ``[camera]``."""
        whole = f"[camera]\n{text}"
        return cls(manifold, _native.Camera.read(manifold._native, f"manifold = 'space'\n{whole}"))

    @property
    def at(self) -> Floats:
        """Where it is: chart point."""
        return np.array(self._native.at)

    @property
    def fov(self) -> float:
        """Horizontal angle of view, or the angle across the circle of a fisheye, degrees."""
        return self._native.fov

    @property
    def projection(self) -> str:
        """How pixels become directions: ``perspective``, ``panorama``, ``fisheye``, ``orthographic`` or ``cube``."""
        return self._native.projection

    @property
    def velocity(self) -> Floats | None:
        """Velocity past the normal observer, standard frame, where light has 1; None where nothing can move so."""
        found = self._native.velocity
        return None if found is None else np.array(found)

    @property
    def text(self) -> str:
        """The lines of the ``[camera]`` of a scene file."""
        return self._native.text

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
            Lengths in the metric, along its own axes. It stops where the space ends, or where the steps of the
            integrator do (as in :meth:`Manifold.trace`).

        Raises
        ------
        InputError
            The way is so long that not a single step of it can be followed.
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
        """Returns the camera with another angle of view, in degrees; a perspective or a fisheye has one."""
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
            From the upper left pixel on; unit vectors. Of a camera with a crop, the part that it draws.

        Raises
        ------
        InputError
            The camera draws several pictures, or its rays start at different points (orthographic).
        """
        width, height = counts("size", size, 2)
        found = self._native.directions((width, height))
        return found[0].reshape(found[1][1], found[1][0], 3)

    def __repr__(self) -> str:
        at, look = (np.array2string(x, precision=6) for x in (self.at, self.look))
        kind = "" if self.projection == "perspective" else f", {self.projection}"
        wide = f", {self.fov:g}° wide" if self.projection in ("perspective", "fisheye") else ""
        return f"<camera at {at} looking {look}{wide}{kind}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.manifold, self.text)


def _rebuilt(manifold: Manifold, text: str) -> Camera:
    return Camera._read(manifold, text)
