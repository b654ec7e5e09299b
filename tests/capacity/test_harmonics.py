from pathlib import Path

import numpy as np
import pytest
import torch

from nmbg.capacity.harmonics import degrees_for, floats
from nmbg.images import Image
from nmbg.scene import Scene, View
from nmbg.training.start import ColourFit


def test_plain_colours_need_no_directions(scene_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def plain(self: Scene, view: View) -> Image:
        return np.full((view.camera.height, view.camera.width, 3), 90, np.uint8)

    monkeypatch.setattr(Scene, "load_image", plain)
    scene = Scene.load(scene_folder)
    fit = ColourFit([scene.mesh], scene, scene.train, bases=9, folds=4)
    (degrees,) = degrees_for(fit.gains(), 2.0)
    assert (degrees == 0).all()
    assert floats([degrees], 3) == 3 * len(scene.mesh.vertices)


def test_colours_that_follow_the_direction_need_it(
    scene_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def directional(self: Scene, view: View) -> Image:
        return ((0.5 + 0.4 * view.camera.rays()) * 255).round().to(torch.uint8).numpy()

    monkeypatch.setattr(Scene, "load_image", directional)
    scene = Scene.load(scene_folder)
    fit = ColourFit([scene.mesh], scene, scene.train, bases=9, folds=len(scene.train))
    (degrees,) = degrees_for(fit.gains(), 8.0)
    # Of the far shell, most is seen from one direction alone.
    surface = slice(len(degrees) - scene.shell_vertices)
    seen = fit.gains()[0][surface].abs().sum(1) > 0
    assert (degrees[surface][seen] >= 1).float().mean() > 0.5


def test_a_limited_fit_is_the_fit_of_that_degree(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    whole = ColourFit([scene.mesh], scene, scene.train, bases=9, folds=2)
    lower = ColourFit([scene.mesh], scene, scene.train, bases=4, folds=2)
    n = len(scene.mesh.vertices)
    whole.degrees = [torch.ones(n, dtype=torch.int64)]
    (limited,), (expected,) = whole.coefficients(without=1), lower.coefficients(without=1)
    assert torch.allclose(limited[:, :4], expected, atol=1e-4)
    assert (limited[:, 4:] == 0).all()
    whole.degrees = None
    (reduced,) = whole.reduced(1).coefficients(without=1)
    assert torch.allclose(reduced, expected, atol=1e-4)
