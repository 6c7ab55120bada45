"""Spaces that come with the package, as functions of their parameters.

>>> import geofan as gf
>>> gf.catalogue.schwarzschild(M=0.95).parameters
{'M': 0.95}

``gf.catalogue.names()`` lists them. Each is a commented text: ``print(gf.catalogue.nil().text)``.
"""

from __future__ import annotations

from importlib import resources
from typing import Protocol

from ._manifold import Manifold


class Maker(Protocol):
    """Makes a manifold of the catalogue, with these values in place of its parameters."""

    def __call__(self, **parameters: float) -> Manifold: ...


def _folder() -> resources.abc.Traversable:
    return resources.files(__package__) / "manifolds"


def names() -> list[str]:
    """Lists the names of the spaces."""
    files = (item.name for item in _folder().iterdir())
    return sorted(name[:-5].replace("-", "_") for name in files if name.endswith(".toml"))


def __getattr__(name: str) -> Maker:
    if name.startswith("_") or name not in names():
        raise AttributeError(f"the catalogue has no space {name!r}; see catalogue.names()")
    file = _folder() / f"{name.replace('_', '-')}.toml"
    text = file.read_text(encoding="utf-8")

    def make(**parameters: float) -> Manifold:
        # By its file where there is one, as fields are files beside it.
        with resources.as_file(file) as path:
            return Manifold(path, parameters=parameters)

    make.__name__ = make.__qualname__ = name
    make.__doc__ = text.split("name =")[0].replace("# ", "").strip()
    return make


def __dir__() -> list[str]:
    return [*names(), "names"]
