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
    model = replace(PRESETS["mesh"].model, degree=1, supersample=1)
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


def test_a_fold_left_out_was_never_there(scene_folder: Path) -> None:
    """Leaving out a fold gives the fit of the others, but for vertices that it alone sees."""
    scene = Scene.load(scene_folder)
    folds = 3
    fit = ColourFit([scene.mesh], scene, scene.train, 4, folds)
    others = [view for i, view in enumerate(scene.train) if i % folds != 1]
    assert {fit.fold_of(view) for view in others} == {0, 2}
    rest = ColourFit([scene.mesh], scene, others, 4)
    (coeffs,), (expected,) = fit.coefficients(without=1), rest.coefficients()
    seen_by_others = rest._sums[0][0, :, 0, 0] > 0
    alone = ~seen_by_others & (fit._sums[0][1, :, 0, 0] > 0)
    assert seen_by_others.any()
    assert alone.any()
    torch.testing.assert_close(coeffs[seen_by_others], expected[seen_by_others], atol=1e-4, rtol=1e-4)
    assert torch.equal(coeffs[alone], coeffs[alone][:1].expand_as(coeffs[alone]))
    assert not torch.allclose(coeffs, fit.coefficients()[0], atol=1e-3)


def test_folds_do_not_change_the_fit_of_all(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    (whole,), (folded,) = (ColourFit([scene.mesh], scene, scene.train, 4, n).coefficients() for n in (1, 3))
    torch.testing.assert_close(whole, folded, atol=1e-4, rtol=1e-4)
