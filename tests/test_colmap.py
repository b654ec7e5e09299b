from __future__ import annotations

import subprocess
import sys

CODE = """
import os, signal, sys
signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))
import nmbg.preprocess, nmbg.demo.capture
os.kill(os.getpid(), signal.SIGTERM)
"""


def test_importing_leaves_the_termination_handler_alone() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=120)
    assert done.returncode == 7, done.stderr
    assert "stack trace" not in done.stderr
