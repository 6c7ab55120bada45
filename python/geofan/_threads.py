"""How many threads work runs on."""

from __future__ import annotations

from types import TracebackType

from . import _native
from ._arrays import count


class threads:
    """Lets the calls of a ``with`` block run on so many threads.

    Parameters
    ----------
    n : int
        The number of threads, from 1.

    Blocks may be nested, and each thread of Python has its own. Without, calls use as many threads as there are
    processors. Results do not depend on it. Workers of ``multiprocessing``, Dask or Ray make threads of their
    own: give each of several workers on one machine its share.

    >>> import geofan as gf
    >>> with gf.threads(2):
    ...     gf.thread_count()
    2
    """

    def __init__(self, n: int) -> None:
        self.n = count("threads", n)

    def __enter__(self) -> threads:
        _native.push_threads(self.n)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        _native.pop_threads()


def thread_count() -> int:
    """Returns the number of threads that calls from this thread run on."""
    return _native.thread_count()
