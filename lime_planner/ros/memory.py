"""Gives memory that was freed back to the system, so that a node that runs for weeks does not grow."""

from __future__ import annotations

import ctypes
from collections.abc import Callable


def _find_trim() -> Callable[[int], int] | None:
    try:
        trim: Callable[[int], int] = ctypes.CDLL(None).malloc_trim  # glibc's; calls release the GIL
    except (OSError, AttributeError, TypeError):
        return None
    return trim


_TRIM = _find_trim()


def give_back() -> None:
    """Return freed pages to the system; takes a few milliseconds, and does nothing where the C library is not glibc.

    A plan allocates and frees tens of megabytes of distance fields in several threads. glibc keeps what lies between blocks that are
    still in use, in an arena for each thread, so that without this the node grows with every rare combination of sizes.
    """
    if _TRIM is not None:
        _TRIM(0)
