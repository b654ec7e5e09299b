from dataclasses import replace
from pathlib import Path

import pytest
import torch

from nmbg.model.descriptors import SH_CONSTANT
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.start import fitted_colours, harmonics, mean_colours
from nmbg.training.views import Views


def test_harmonics_of_known_directions() -> None:
    rays = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]])
    basis = harmonics(rays, PRESETS["mesh"].model)[:, 0]
    torch.testing.assert_close(basis[0], torch.full((3,), 0.28209479))
    torch.testing.assert_close(basis[1:4].T, 0.48860251 * torch.tensor([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]]))
    torch.testing.assert_close(basis[6], 0.31539157 * torch.tensor([-1.0, -1, 2]))
    torch.testing.assert_close(basis[8], 0.54627422 * torch.tensor([1.0, -1, 0]))


def test_mean_colours_show_the_vertex_colours(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    renderer = Renderer(PRESETS["colours"].model, [scene.mesh])
    (coeffs,) = mean_colours(renderer)
    assert coeffs.shape == (len(scene.mesh.vertices), 1, 3)
    torch.testing.assert_close(coeffs[:, 0] * SH_CONSTANT * 255, torch.from_numpy(scene.mesh.colours).float())


@pytest.mark.parametrize("supersample", [1, 2])
def test_fit_is_nearer_to_the_photographs_than_the_mean(scene_folder: Path, supersample: int) -> None:
    scene = Scene.load(scene_folder)
    renderer = Renderer(replace(PRESETS["mesh"].model, supersample=supersample), [scene.mesh])
    views = Views(scene, scene.train, renderer.rasterize, 1.0)

    def error() -> float:
        frames = [views.frame(i) for i in range(len(views))]
        return sum(
            float((renderer(f.fragments, f.camera) - f.image / 255).square().mean().detach()) for f in frames
        )

    renderer.set_colours(mean_colours(renderer))
    mean = error()
    renderer.set_colours(fitted_colours(renderer, views))
    assert error() < 0.97 * mean


def test_fit_recovers_harmonics(scene_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Photographs rendered from harmonics that all vertices share: the fit shows the same pictures."""
    scene = Scene.load(scene_folder)
    model = replace(PRESETS["mesh"].model, degree=1)
    truth = Renderer(model, [scene.mesh])
    coeffs = torch.zeros(len(scene.mesh.vertices), 4, 3)
    coeffs[:, 0] = 0.5 / SH_CONSTANT
    coeffs[:, 1:4] = torch.tensor([[0.1, 0.0, 0.1], [0.0, 0.2, 0.1], [-0.1, 0.1, 0.0]])
    truth.set_colours([coeffs])

    def rendered(self: Scene, view: object) -> object:
        return (truth.render(view.camera) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()  # type: ignore[attr-defined]

    monkeypatch.setattr(Scene, "load_image", rendered)
    views = Views(scene, scene.train, truth.rasterize, 1.0)
    (fitted,) = fitted_colours(truth, views, shrinkage=1e-5)
    fit = Renderer(model, [scene.mesh])
    fit.set_colours([fitted])
    for view in scene.train:
        face = truth.rasterize(view.camera)[0].levels[0].face
        seen = face >= 0
        difference = (fit.render(view.camera) - truth.render(view.camera)).abs()[:, seen]
        assert difference.median() < 0.01
