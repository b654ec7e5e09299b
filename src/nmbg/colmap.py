"""pycolmap, imported here alone, because its import takes over SIGTERM.

It would print a stack trace and end the process before anything half-written is removed. Elsewhere:
`from nmbg.colmap import pycolmap`.
"""

import signal
import threading

_before = signal.getsignal(signal.SIGTERM)

import pycolmap  # noqa: E402

# Python may set handlers from its main thread only; `None` stands for one that was not set from Python.
if _before is not None and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGTERM, _before)

__all__ = ["pycolmap"]
