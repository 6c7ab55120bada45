"""How much memory a call may take."""

from __future__ import annotations

import os
import sys

#: The part of the machine's memory that one result may have.
_SHARE = 0.75


def most_bytes() -> int:
    """Returns how many bytes a result may take: a share of the machine's memory, and of what a limit of the process leaves."""
    found = [sys.maxsize]
    try:
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):  # not on Windows
        pass
    limit = _limit()
    if limit is not None:
        found.append(limit)
    return int(_SHARE * min(found))


def _limit() -> int | None:
    """Returns what ``ulimit -v`` leaves to the process, where there is such a limit and it can be told."""
    try:
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most == resource.RLIM_INFINITY:
            return None
        with open("/proc/self/statm", encoding="ascii") as file:
            taken = int(file.read().split()[0]) * resource.getpagesize()
    except (ImportError, OSError, ValueError):
        return None
    return max(most - taken, 0)
