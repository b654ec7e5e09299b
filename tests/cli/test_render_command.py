"""`nmbg render`: pictures and videos of a path through a run's training views."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from click.testing import CliRunner, Result

from nmbg.cli import main
from nmbg.images import read_image
from nmbg.scene import Scene, evenly
from nmbg.training.checkpoint import load_run
from nmbg.training.config import PRESETS
from nmbg.training.trainer import train


@pytest.fixture(scope="module")
def run(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(Scene.load(scene_folder), PRESETS["photos"], tmp_path_factory.mktemp("runs") / "run")


def render(*words: object) -> Result:
    return CliRunner().invoke(main, ["render", *map(str, words)])


def test_a_folder_gets_a_picture_a_frame_from_the_first_view_to_the_last(
    run: Path, scene_folder: Path, tmp_path: Path
) -> None:
    output = tmp_path / "path"
    done = render(run, "--output", output, "--views", 3, "--frames", 5)
    assert done.exit_code == 0, done.output
    pictures = sorted(output.glob("*.png"))
    assert [picture.name for picture in pictures] == [f"000{i}.png" for i in range(5)]
    renderer, passed = load_run(run).renderer, evenly(Scene.load(scene_folder).train, 3)
    for picture, view in ((pictures[0], passed[0]), (pictures[-1], passed[-1])):
        wanted = renderer.render(view.camera).permute(1, 2, 0).numpy() * 255
        # Rotations went through quaternions: a pixel at an edge may fall to the other side.
        assert np.abs(read_image(picture) - wanted).mean() < 1
    between = read_image(pictures[1]).astype(float)
    assert min(np.abs(between - read_image(pictures[i])).mean() for i in (0, 4)) > 2


def test_a_video_holds_every_frame_and_odd_sizes_lose_a_row(run: Path, tmp_path: Path) -> None:
    output = tmp_path / "path.mp4"
    words = ("--views", 3, "--frames", 7, "--fps", 10, "--max-size", 33)
    assert render(run, "--output", output, *words).exit_code == 0
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(output))
    assert (count, seconds) == (7, pytest.approx(0.7, abs=0.05))
    decode = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", output, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    decoded = subprocess.run(decode, capture_output=True, check=True).stdout
    height, width = 24, 32
    film = np.frombuffer(decoded, np.uint8).reshape(7, height, width, 3)
    assert render(run, "--output", tmp_path / "pictures", *words).exit_code == 0
    pictures = [read_image(path)[:height, :width] for path in sorted((tmp_path / "pictures").glob("*.png"))]
    away = np.abs(film[:, None].astype(float) - np.stack(pictures)).mean((2, 3, 4))
    assert (away.argmin(1) == np.arange(7)).all()
    assert away.diagonal().max() < 15  # colours of such small frames lose more than brightness
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize("name", ["pictures", "path.mp4"])
def test_what_exists_is_replaced_only_when_asked(run: Path, tmp_path: Path, name: str) -> None:
    words = (run, "--output", tmp_path / name, "--views", 2, "--frames", 2, "--max-size", 16)
    assert render(*words).exit_code == 0
    refused = render(*words)
    assert refused.exit_code == 2
    assert "exists" in refused.output
    assert len(refused.output.splitlines()) == 1
    assert render(*words, "--overwrite").exit_code == 0


def test_a_video_without_ffmpeg_names_the_remedy_and_leaves_nothing(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    refused = render(run, "--output", tmp_path / "path.mp4")
    assert refused.exit_code == 2
    assert "pip install 'nmbg[video]'" in refused.output
    assert not list(tmp_path.iterdir())


def test_a_run_of_several_scenes_or_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for folder in (tmp_path / "empty", tmp_path / "absent"):
        refused = render(folder, "--output", tmp_path / "path")
        assert refused.exit_code == 2
        assert str(folder) in refused.output.replace("\n", "")
