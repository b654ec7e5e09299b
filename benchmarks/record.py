"""What the tables have in common: where numbers came from, and how they are written down."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Any

import torch

from nmbg import __version__
from nmbg.allocator import keep_freed_memory
from nmbg.atomic import atomic_file
from nmbg.errors import NmbgError
from nmbg.evaluation.machine import machine

os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")  # as the command line does
keep_freed_memory()


def _tell(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What a user did wrong ends a benchmark as it ends the command line."""
    if not isinstance(error, NmbgError):
        sys.__excepthook__(kind, error, trace)
        return
    print("error:", error, file=sys.stderr)
    sys.exit(2)


sys.excepthook = _tell


def command() -> str:
    """The command line that this runs under, from the project's root."""
    script, *rest = sys.argv
    return " ".join(["python", f"benchmarks/{Path(script).name}", *rest])


def provenance() -> dict[str, Any]:
    """What numbers depend on besides command and settings."""
    return {
        "commit": commit(),
        "nmbg": __version__,
        "torch": torch.__version__,
        "machine": machine("cpu"),
    }


def commit() -> str:
    """The commit that runs, with a mark where files differ from it; empty outside a repository."""
    words = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--abbrev=12", "--dirty"]
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()


def write(folder: Path, name: str, results: dict[str, Any], table: str) -> None:
    """Write NAME.json and NAME.md into a folder."""
    with atomic_file(folder / f"{name}.json") as path:
        path.write_text(json.dumps(results, indent=1))
    with atomic_file(folder / f"{name}.md") as path:
        path.write_text(table)


def cell(metrics: dict[str, float]) -> str:
    """PSNR / SSIM / LPIPS."""
    lpips = next(value for key, value in metrics.items() if key.startswith("lpips"))
    return f"{metrics['psnr']:.2f} / {metrics['ssim']:.3f} / {lpips:.3f}"
