"""What `nmbg train` refuses before any work starts."""

from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from nmbg.cli import main
from nmbg.model.renderer import Renderer


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--photos", "0"], "--preset mesh"),
        (["--photos", "few"], "auto or all"),
        (["--preset", "mesh", "--photos", "4"], "blends no photographs"),
        (["--perceptual", "vgg19"], "without L_rec"),
        (["--start", "mean"], "leave start out"),
        (["--minutes", "1", "--epochs", "1"], "one of iterations, epochs and minutes"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    scene_folder: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    out = tmp_path / "run"
    result = CliRunner().invoke(main, ["train", str(scene_folder), "--output", str(out), *words])
    assert result.exit_code == 2
    assert message in result.stderr
    assert not out.exists()


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError(
            "[enforce fail at alloc_cpu.cpp:127] err == 0. DefaultCPUAllocator: can't allocate memory: you "
            "tried to allocate 9000000000 bytes. Error code 12 (Cannot allocate memory)"
        ),
        torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB."),
    ],
)
def test_out_of_memory_says_which_option_helps(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(Renderer, "rasterize", fail)
    words = [
        "train",
        str(scene_folder),
        "--output",
        str(tmp_path / "run"),
        "--preset",
        "mesh",
        "--cache",
        "3",
    ]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert "out of memory" in result.stderr
    assert "--cache 1.5 holds 1.5 GiB less" in result.stderr
    assert "--window" not in result.stderr  # the preset has no network


def test_other_errors_are_not_taken_for_a_lack_of_memory(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("something else")

    monkeypatch.setattr(Renderer, "rasterize", fail)
    words = ["train", str(scene_folder), "--output", str(tmp_path / "run"), "--preset", "mesh"]
    result = CliRunner().invoke(main, words)
    assert isinstance(result.exception, RuntimeError)
