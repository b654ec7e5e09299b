"""What the process does with memory that it no longer needs."""

from __future__ import annotations

import ctypes
import platform

# Of mallopt(), which takes a C int.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_LARGEST_KEPT = 2**30  # bytes; what is larger still goes back to the system at once


def keep_freed_memory() -> None:
    """Keep freed tensors' memory for those that come next, where the C library is glibc.

    A step and a frame ask for the same hundreds of megabytes as the one before. glibc hands large blocks back
    to the system as soon as they are freed, and each of their pages then costs a fault again.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_MMAP_THRESHOLD, _LARGEST_KEPT)
        libc.mallopt(_TRIM_THRESHOLD, -1)  # never
