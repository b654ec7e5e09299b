"""nmbg info."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import click
import torch

from nmbg import __version__, _core
from nmbg.backbones import NETS, hub_cache, installed_weights
from nmbg.cli.options import weights_option
from nmbg.evaluation.machine import cpu_model

PACKAGES = ("torch", "numpy", "pycolmap", "trimesh", "OpenImageIO", "torchmetrics", "safetensors")
OPENMP_LIBRARIES = ("libgomp", "libomp", "libiomp")


@click.command(epilog="Example: nmbg info --weights weights")
@weights_option
def command(weights: Path | None) -> None:
    """Show versions, threads, devices and pretrained weights."""
    for key, value in _lines(weights):
        click.echo(f"{key:<14} {value}")


def _lines(weights: Path | None) -> Iterator[tuple[str, str]]:
    yield "nmbg", f"{__version__}, kernels {_core.version}"
    yield "python", f"{platform.python_version()} on {platform.platform()}"
    for package in PACKAGES:
        yield package, version(package)
    yield "processor", cpu_model()
    yield "threads", f"{torch.get_num_threads()} of {os.cpu_count()} processors"
    yield "openmp", _openmp()
    yield "simd", f"kernels {_core.simd}; torch {torch.backends.cpu.get_cpu_capability()}"
    yield "devices", ", ".join(_devices())
    yield "weights in", ", ".join(str(folder) for folder in (weights, hub_cache()) if folder is not None)
    for net, known in NETS.items():
        found = installed_weights(net, weights)
        yield f"  {net}", str(found) if found else f"not found ({known.file}); downloaded when it is needed"


def _openmp() -> str:
    """Whether the kernels are parallel, and which OpenMP runtimes this process has loaded: one is right."""
    if not _core.openmp:
        return "no: the kernels were built without it and run on one thread"
    loaded = _loaded_libraries()
    if loaded is None:
        return "yes"
    return f"yes, {len(loaded)} runtime{'' if len(loaded) == 1 else 's'}: {', '.join(loaded)}"


def _loaded_libraries() -> list[str] | None:
    """OpenMP libraries mapped into this process; None where the system does not tell."""
    if sys.platform != "linux":
        return None
    maps = Path("/proc/self/maps").read_text().splitlines()
    mapped = {line.split(maxsplit=5)[5] for line in maps if "/" in line}
    return sorted(path for path in mapped if Path(path).name.startswith(OPENMP_LIBRARIES))


def _devices() -> list[str]:
    names = [f"cuda:{i} {torch.cuda.get_device_name(i)}" for i in range(torch.cuda.device_count())]
    return ["cpu", *names]
