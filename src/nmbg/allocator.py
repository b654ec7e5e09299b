"""What the process does with memory that it no longer needs."""

from __future__ import annotations

import ctypes
import platform

# Of glibc's mallopt().
_TRIM_THRESHOLD, _MMAP_MAX = -1, -4


def keep_freed_memory() -> None:
    """Keep freed tensors' memory for those that come next, where the C library is glibc.

    A step and a frame ask for the same hundreds of megabytes as the one before. glibc maps large blocks one
    by one and hands them back to the system when they are freed: each of their pages then costs a fault
    again.
    """
    if platform.libc_ver()[0] == "glibc":
        libc = ctypes.CDLL(None)
        libc.mallopt(_MMAP_MAX, 0)
        libc.mallopt(_TRIM_THRESHOLD, -1)  # never
