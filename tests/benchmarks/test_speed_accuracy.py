"""The points of the speed and accuracy charts, and the plainest baseline among them."""

import importlib
import json
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from nmbg.model.renderer import make_network
from nmbg.scene import Scene
from nmbg.training.config import PRESETS


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("speed_accuracy")


def point(name: str, psnr: float | None, lpips: float, minutes: float | None) -> dict[str, object]:
    costs = {"minutes": minutes, "milliseconds": 1.0, "megabytes": None}
    return {"name": name, "budget": None, "psnr": psnr, "ssim": 0.5, "lpips_squeeze": lpips, **costs}


def test_the_front_takes_more_psnr_and_less_lpips_for_more_minutes(benchmark: ModuleType) -> None:
    points = [
        point("a", 20, 0.1, 1),
        point("b", 22, 0.3, 2),
        point("c", 21, 0.05, 3),
        point("d", 30, 0.01, None),
    ]
    assert benchmark._front(points, "psnr", "minutes") == [0, 1]
    assert benchmark._front(points, "lpips_squeeze", "minutes") == [0, 2]
    assert benchmark._front(points, "psnr", "megabytes") == []


def test_points_of_unknown_cost_are_in_the_table_and_the_picture_is_sound(benchmark: ModuleType) -> None:
    points = [point("a", 20, 0.1, 0.0), point("<b>", None, 0.3, None)]
    points[0] |= {"budget": 0.0, "machine": {"cpu": "c", "threads": 1}}
    results = {
        "scene": "s",
        "seed": 0,
        "machine": {"cpu": "of what tabulates", "threads": 2},
        "points": points,
        "fronts": {"psnr / minutes": benchmark._front(points, "psnr", "minutes")},
    }
    assert "| <b> |  |  | 0.5000 | 0.3000 |  | 1 |  |" in benchmark._table(results)
    assert benchmark._table(results).startswith("Held-out views of s; c, 1 threads, seed 0.")
    assert "- psnr / minutes: a\n" in benchmark._table(results)
    ET.fromstring(benchmark._draw(points))


def test_every_variant_is_a_model_that_can_be_made(benchmark: ModuleType) -> None:
    assert set(PRESETS) < set(benchmark.VARIANTS)
    keys = set()
    for name, variant in benchmark.VARIANTS.items():
        config = benchmark.trained_for(variant.preset, 1.0)
        model = benchmark.replace(config.model, **variant.model)
        assert (make_network(model) is None) == (not model.widths), name
        keys.add(json.dumps([str(model), str(config), variant.scene, variant.bf16]))
    assert len(keys) == len(benchmark.VARIANTS)


def test_a_photograph_warped_to_its_own_place_is_itself(benchmark: ModuleType, scene_folder: Path) -> None:
    nearest = importlib.import_module("nearest")
    scene = Scene.load(scene_folder)
    view = scene.train[0]
    assert nearest.nearest(scene, view.camera) is view
    photograph = scene.load_image(view)
    warped = nearest.warp(scene, view.camera, view.camera, photograph)
    seen = nearest.look(scene.mesh, view.camera).covered.numpy()
    assert seen.mean() > 0.5
    assert np.abs(warped[seen].astype(int) - photograph[seen]).max() <= 1


def test_what_is_close_to_the_best_is_drawn_once_more(benchmark: ModuleType) -> None:
    points = [point("far", 20, 0.1, 1), point("near", 28, 0.1, 2), point("best", 30, 0.1, 3)]
    told = benchmark._draw(points)
    # Minutes and milliseconds are known: PSNR, SSIM and LPIPS for all, PSNR once more for two.
    assert [told.count(f"<title>{name}:") for name in ("far", "near", "best")] == [6, 8, 8]
