from dataclasses import replace
from pathlib import Path

import pytest
import torch

from nmbg.model.descriptors import SH_CONSTANT
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.start import ColourFit, mean_colours
from nmbg.training.views import Views


def test_mean_colours_show_the_vertex_colours(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    renderer = Renderer(PRESETS["colours"].model, [scene.mesh])
    (coeffs,) = mean_colours(renderer.layers)
    assert coeffs.shape == (len(scene.mesh.vertices), 1, 3)
    torch.testing.assert_close(coeffs[:, 0] * SH_CONSTANT * 255, torch.from_numpy(scene.mesh.colours).float())


def test_fit_is_nearer_to_the_photographs_than_the_mean(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    renderer = Renderer(PRESETS["mesh"].model, [scene.mesh])
    views = Views(scene, scene.train, lambda camera, _: renderer.rasterize(camera), 1.0)

    def error() -> float:
        frames = [views.frame(i) for i in range(len(views))]
        return sum(
            float((renderer(f.sight, f.camera) - f.image / 255).square().mean().detach()) for f in frames
        )

    renderer.set_colours(mean_colours(renderer.layers))
    mean = error()
    renderer.set_colours(ColourFit(renderer.layers, scene, scene.train, 9).coefficients())
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
    (fitted,) = ColourFit([scene.mesh], scene, scene.train, 4, ridge=(1e-5, 1e-5)).coefficients()
    fit = Renderer(model, [scene.mesh])
    fit.set_colours([fitted])
    for view in scene.train:
        face = truth.rasterize(view.camera)[0].levels[0].face
        seen = face >= 0
        difference = (fit.render(view.camera) - truth.render(view.camera)).abs()[:, seen]
        assert difference.median() < 0.01


def test_unseen_vertices_keep_their_mean(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    (fitted,), (mean,) = ColourFit([scene.mesh], scene, [], 9).coefficients(), mean_colours([scene.mesh])
    torch.testing.assert_close(fitted[:, :1], mean)
    assert torch.equal(fitted[:, 1:], torch.zeros_like(fitted[:, 1:]))


def test_a_view_taken_out_was_never_there(scene_folder: Path) -> None:
    """Taking out one view's sums gives the fit of the others, but for vertices that it alone sees."""
    scene = Scene.load(scene_folder)
    out, *others = scene.train
    fit = ColourFit([scene.mesh], scene, scene.train, 4)
    ((vertices, coeffs),) = fit.without(out)
    rest = ColourFit([scene.mesh], scene, others, 4)
    (expected,) = rest.coefficients()
    weight = rest._sums[0][vertices, 0, 0]
    shared, alone = weight > 0.02, weight == 0
    assert shared.any()
    assert alone.any()
    torch.testing.assert_close(coeffs[shared], expected[vertices[shared]], atol=2e-2, rtol=2e-2)
    assert torch.equal(coeffs[alone], coeffs[alone][:1].expand_as(coeffs[alone]))
    assert not torch.allclose(coeffs, fit.coefficients()[0][vertices], atol=1e-3)
