"""Curved 3-dimensional spaces: geodesics, certified lookup tables, pictures.

A space is a metric or an embedding, from a text file, in code, or from the catalogue. Everything takes numpy arrays of
any leading axes and runs on all processors without the interpreter's lock.

>>> import geofan as gf
>>> hole = gf.catalogue.schwarzschild(M=1)
>>> paths = hole.trace([9.0, 0.0, 0.0], [[-1.0, 0.2, 0.0], [-1.0, 0.8, 0.0]])
>>> paths.end.tolist()
['horizon', 'sky']
"""

from . import catalogue
from ._bundle import Bundle, Certificate, Quantiles
from ._camera import Camera
from ._errors import GeofanError, GeofanWarning, InputError, ManifoldError, SceneError
from ._image import Comparison, Image
from ._manifold import Manifold
from ._native import __version__
from ._page import View, page, view
from ._paths import Connections, Lookups, Paths, Skies
from ._scene import Scene
from ._sweep import sweep
from ._threads import thread_count, threads

__all__ = [
    "Bundle",
    "Camera",
    "Certificate",
    "Comparison",
    "Connections",
    "GeofanError",
    "GeofanWarning",
    "Image",
    "InputError",
    "Lookups",
    "Manifold",
    "ManifoldError",
    "Paths",
    "Quantiles",
    "Scene",
    "SceneError",
    "Skies",
    "View",
    "__version__",
    "catalogue",
    "page",
    "sweep",
    "thread_count",
    "threads",
    "view",
]
