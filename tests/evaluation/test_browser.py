"""The pages in a browser: they are drawn, and nothing is complained about."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmbg.evaluation.compare import read_all, write_comparison
from nmbg.evaluation.evaluate import evaluate
from nmbg.images import read_image
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.trainer import train

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def runs(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    home, scene = tmp_path_factory.mktemp("pages"), Scene.load(scene_folder)
    sized = replace(PRESETS["nmbg"], capacity="auto", minutes=None, iterations=4, refine="none")
    found = [train(scene, config, home / config.preset) for config in (PRESETS["photos"], sized)]
    for run in found:
        evaluate(run, ["psnr", "ssim"])
    return found


def opened(page: Path, home: Path) -> np.ndarray:
    """The page as a browser draws it; fails where its console says anything."""
    picture = home / f"{page.stem}.png"
    assert CHROMIUM is not None
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1000,3000"]
    log = ["--enable-logging=stderr", f"--user-data-dir={home / 'profile'}"]
    command = [CHROMIUM, *flags, *log, f"--screenshot={picture}", page.resolve().as_uri()]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    assert "CONSOLE" not in result.stderr, result.stderr
    return read_image(picture)


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the path")
def test_pages_are_drawn_without_complaint(runs: list[Path], tmp_path: Path) -> None:
    page = tmp_path / "compared.html"
    write_comparison(page, read_all(runs))
    for each in (page, *(run / "report.html" for run in runs)):
        drawn = opened(each, tmp_path)
        assert drawn.shape == (3000, 1000, 3)
        # Pictures and charts, not a page of text alone.
        colourful = np.ptp(drawn.astype(int), axis=2) > 40
        assert colourful.mean() > 0.002, each


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the path")
def test_complaints_are_heard(tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text("<html><body><script>console.error('broken')</script></body></html>")
    with pytest.raises(AssertionError, match="broken"):
        opened(page, tmp_path)
