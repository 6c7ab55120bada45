from typing import Any, final

import numpy as np
import numpy.typing as npt

from ._progress import Told

_Floats = npt.NDArray[np.float64]
_Three = tuple[float, ...]
_Window = tuple[tuple[tuple[int, int], tuple[int, int]] | None, float | None]
_Baked = tuple[Bundle | None, list[str]]
_Compared = tuple[str, str, npt.NDArray[np.float32], dict[str, npt.NDArray[np.float32]]]

__all__ = [
    "Bundle",
    "Camera",
    "Manifold",
    "Stage",
    "__version__",
    "journey",
    "page",
    "pop_threads",
    "push_threads",
    "read_picture",
    "sweep",
    "thread_count",
    "write_picture",
]

__version__: str

@final
class Manifold:
    @staticmethod
    def load(path: str, settings: list[tuple[str, float]]) -> Manifold: ...
    @staticmethod
    def parse(name: str, text: str, settings: list[tuple[str, float]]) -> Manifold: ...
    @property
    def source(self) -> tuple[str, str]: ...
    @property
    def name(self) -> str: ...
    @property
    def coordinates(self) -> tuple[str, str, str]: ...
    @property
    def parameters(self) -> list[tuple[str, float]]: ...
    @property
    def ends(self) -> list[str]: ...
    @property
    def length(self) -> float | None: ...
    @property
    def ambient(self) -> int | None: ...
    @property
    def form(self) -> str: ...
    @property
    def cameras(self) -> list[tuple[str, list[float]]] | None: ...
    def lines(self) -> list[tuple[str, str]]: ...
    def mirrors(self, length: float | None) -> int: ...
    def differences(self, other: Manifold) -> list[str]: ...
    def camera_point(self, given: list[tuple[str, float]]) -> list[float]: ...
    def at(self, quantity: str, u: _Floats) -> _Floats: ...
    def transport_along(
        self, curve: tuple[str, str, str], interval: tuple[float, float], accuracy: float
    ) -> list[list[float]]: ...
    def transport_through(self, points: _Floats, accuracy: float) -> list[list[float]]: ...
    def trace(
        self,
        at: _Floats,
        direction: _Floats,
        length: float | None,
        samples: int,
        s: _Floats | None,
        accuracy: float,
        forward: bool,
        carried: tuple[bool, bool],
        conjugate: bool,
    ) -> dict[str, Any]: ...
    def connect(
        self, p: tuple[float, float, float], q: _Floats, length: float | None, accuracy: float
    ) -> dict[str, Any]: ...

@final
class Camera:
    @staticmethod
    def read(manifold: Manifold, text: str) -> Camera: ...
    @property
    def text(self) -> str: ...
    @property
    def projection(self) -> str: ...
    @property
    def velocity(self) -> list[float] | None: ...
    @property
    def at(self) -> list[float]: ...
    @property
    def fov(self) -> float: ...
    @property
    def rotation(self) -> list[list[float]]: ...
    @property
    def axes(self) -> list[list[float]]: ...
    def moved(self, by: tuple[float, float, float]) -> tuple[Camera, float]: ...
    def turned(self, by: tuple[float, float, float]) -> Camera: ...
    def zoomed(self, fov: float) -> Camera: ...
    def directions(self, size: tuple[int, int]) -> tuple[_Floats, tuple[int, int]]: ...

@final
class Bundle:
    @staticmethod
    def read(path: str) -> Bundle: ...
    @staticmethod
    def from_bytes(bytes: bytes) -> Bundle: ...
    @staticmethod
    def bake(
        manifold: Manifold,
        output: str,
        promises: tuple[float | None, float | None],
        max_size: int | None,
        length: float | None,
        switches: tuple[bool, ...],
        share: tuple[int, int] | None,
        certify_rays: int,
        progress: Told | None,
    ) -> _Baked: ...
    @staticmethod
    def merge(shares: list[str], output: str, progress: Told | None) -> _Baked: ...
    @property
    def id(self) -> str: ...
    @property
    def kept(self) -> bool | None: ...
    @property
    def sky_kept(self) -> bool | None: ...
    def to_bytes(self) -> bytes: ...
    def write(self, path: str) -> int: ...
    @property
    def manifold(self) -> Manifold: ...
    @property
    def length(self) -> float: ...
    def info(self) -> str: ...
    def check(self, rays: int, seed: int, progress: Told | None) -> str: ...
    def trace(
        self, at: _Floats, direction: _Floats, length: float | None, samples: int, accuracy: float
    ) -> dict[str, Any]: ...
    def paths(
        self, camera: tuple[float, float, float], directions: _Floats, s: _Floats, accuracy: float
    ) -> dict[str, Any]: ...
    def sky(
        self, camera: tuple[float, float, float], directions: _Floats, accuracy: float
    ) -> dict[str, Any]: ...

@final
class Stage:
    @staticmethod
    def load(path: str, settings: list[tuple[str, float]]) -> Stage: ...
    @staticmethod
    def parse(text: str, folder: str, manifold: Manifold, meshes: list[Any]) -> Stage: ...
    @property
    def text(self) -> str: ...
    @property
    def manifold(self) -> Manifold: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def views(self) -> list[str]: ...
    def camera(self, name: str | None) -> Camera: ...
    def render(
        self,
        camera: Camera | None,
        request: dict[str, Any],
        tracer: str | None,
        bundle: Bundle | None,
        light_file: str | None,
        layers: bool,
        progress: Told | None,
    ) -> dict[str, Any]: ...
    def path_trace(
        self,
        camera: Camera | None,
        request: dict[str, Any],
        seed: int,
        bounces: int | None,
        seconds: float | None,
        layers: bool,
        progress: Told | None,
    ) -> dict[str, Any]: ...
    def compare(
        self,
        camera: Camera | None,
        request: dict[str, Any],
        bundle: Bundle,
        light_file: str | None,
        frames: int,
    ) -> _Compared: ...
    def compare_local(self, camera: Camera | None, request: dict[str, Any]) -> _Compared: ...

def journey(
    manifold: Manifold, text: tuple[str, str], frames: int, like: Camera | None
) -> list[Camera]: ...
def page(
    file: str,
    bundle: str | None,
    length: float | None,
    settings: list[tuple[str, float]],
    wasm: str,
    output: str | None,
) -> tuple[int, str | None]: ...
def push_threads(count: int) -> None: ...
def pop_threads() -> None: ...
def thread_count() -> int: ...
def read_picture(
    path: str,
) -> tuple[npt.NDArray[np.float32], dict[str, npt.NDArray[Any]], list[tuple[str, str]], _Window]: ...
def write_picture(
    path: str,
    rgb: npt.NDArray[np.float32],
    floats: list[tuple[str, npt.NDArray[np.float32]]],
    indices: list[tuple[str, npt.NDArray[np.uint32]]],
    notes: list[tuple[str, str]],
    window: _Window,
) -> None: ...
def sweep(
    manifolds: list[str],
    out: str,
    quick: bool,
    max_error: list[float],
    cells: list[float],
    rays: int | None,
    seed: int,
    progress: Told | None,
) -> tuple[int, int]: ...
