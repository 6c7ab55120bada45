"""Showing how far long work is."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, Union

#: Called with the name of the work, units done, units in all and further figures.
Told = Callable[[str, int, int, str], None]
#: True for a bar (by tqdm where it is installed), or a function.
Progress = Union[bool, Told]


def teller(progress: Progress) -> Told | None:
    """Returns what is to be told of progress."""
    if progress is True:
        return _Bars()
    return progress or None


class _Bars:
    """Bars by tqdm, or lines on stderr without it; one for each piece of work."""

    def __init__(self) -> None:
        self.bars: dict[str, Any] = {}
        try:
            from tqdm.auto import tqdm
        except ImportError:
            self.make: Any = None
        else:
            self.make = tqdm

    def __call__(self, work: str, done: int, total: int, detail: str) -> None:
        if self.make is None:
            self._line(work, done, total, detail)
            return
        bar = self.bars.get(work)
        if bar is None:
            bar = self.bars[work] = self.make(total=total or None, desc=work)
        if total:
            bar.total = total
        bar.set_postfix_str(detail, refresh=False)
        bar.update(done - bar.n)
        if total and done >= total:
            bar.close()
            del self.bars[work]

    def _line(self, work: str, done: int, total: int, detail: str) -> None:
        end = "\n" if done >= total else "\r"
        share = f"{100 * done / total:3.0f} %" if total else f"{done}"
        print(f"{work}: {share} {detail}".ljust(60), end=end, file=sys.stderr, flush=True)
