from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import torch
from click.testing import CliRunner

from nmbg import _core
from nmbg.cli import main


def told(*words: str) -> dict[str, str]:
    result = CliRunner().invoke(main, ["info", *words])
    assert result.exit_code == 0, result.output
    return {line.split()[0]: line.split(maxsplit=1)[1] for line in result.output.splitlines()}


def test_info_names_versions_threads_and_devices() -> None:
    lines = told()
    assert lines["torch"] == torch.__version__
    assert lines["threads"].startswith(f"{torch.get_num_threads()} of ")
    assert lines["devices"].startswith("cpu")
    assert _core.simd in lines["simd"]


def test_one_openmp_runtime_serves_torch_and_the_kernels() -> None:
    # In a process of its own: other tests may have loaded libraries that bring a runtime along.
    code = "from nmbg.cli import main; main(['info'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    openmp = next(line for line in done.stdout.splitlines() if line.startswith("openmp"))
    assert openmp.split()[1].startswith("yes" if _core.openmp else "no")
    assert "runtimes" not in openmp


def test_info_tells_which_weights_are_found(tmp_path: Path) -> None:
    (tmp_path / "squeezenet1_1-b8a52dc0.pth").touch()
    lines = told("--weights", str(tmp_path))
    assert str(tmp_path) in lines["weights"]
    assert lines["squeezenet1_1"] == str(tmp_path / "squeezenet1_1-b8a52dc0.pth")
    assert "vgg19-dcbb9e9d.pth" in lines["vgg19"]
