"""What a window, an exposure and a mask make of training examples and of what is judged."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from torch import Tensor

from nmbg.errors import NmbgError
from nmbg.images import resize, write_image
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene
from nmbg.training.adversary import Adversary
from nmbg.training.config import BESIDE_L1, PRESETS, without_perceptual
from nmbg.training.loop import _lambda
from nmbg.training.member import Member, begin
from nmbg.training.targets import PerceptualTerm
from nmbg.training.trainer import train
from nmbg.training.views import Views

ADVERSARIAL = replace(PRESETS["adversarial"], perceptual="none", iterations=8, artificial_views=0.5)


def test_least_zoom_of_the_paper_shows_the_whole_frame(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    views = Views(scene, scene.train, lambda camera, _: [], 0.0)
    window = views.window(0, 0.5, (0.5, 0.5), torch.Generator().manual_seed(0))
    whole = scene.train[0].camera
    np.testing.assert_allclose(window.camera.K, whole.resized(32, 24).K)
    # Reduced as preprocess reduces photographs.
    image = torch.from_numpy(resize(scene.load_image(scene.train[0]), 32, 24)).permute(2, 0, 1)
    assert window.image is not None
    assert torch.equal(window.image, image)


@pytest.mark.parametrize("zoom", [(0.4, 1.0), (1.0, 0.5), (float("nan"), 1.0)])
def test_zooms_that_show_more_than_there_is(zoom: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="a zoom from"):
        replace(PRESETS["paper"], zoom=zoom)


def test_windows_too_small_for_the_network_are_refused_before_any_work(
    scene_folder: Path, tmp_path: Path
) -> None:
    config = replace(PRESETS["npbg"], perceptual="none", iterations=1, window=0.2, zoom=(0.5, 1.0))
    with pytest.raises(NmbgError, match="13×10 pixels are too small for a network of 5 levels"):
        train(Scene.load(scene_folder), config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.fixture(scope="module")
def masked(shared_workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A scene whose masks keep the left three quarters of each photograph."""
    home = tmp_path_factory.mktemp("masked")
    mask = np.zeros((48, 64, 3), np.uint8)
    mask[:, :48] = 255
    (home / "masks").mkdir()
    for image in sorted((shared_workspace / "images").iterdir()):
        write_image(home / "masks" / f"{image.name}.png", mask)
    options = PreprocessOptions(test_every=3, masks=home / "masks", background="none")
    return preprocess(shared_workspace, home / "scene", options)


def test_the_discriminator_sees_renders_as_photographs_are_shown(
    masked: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Black outside the mask both; else it tells them apart by what no photograph shows."""
    seen: list[tuple[Tensor, Tensor]] = []
    learn = Adversary.learn

    def note(self: Adversary, render: Tensor, photograph: Tensor, generator: Any) -> Tensor:
        seen.append((render.detach(), photograph))
        return learn(self, render, photograph, generator)

    monkeypatch.setattr(Adversary, "learn", note)
    train(masked, ADVERSARIAL, tmp_path / "run")
    assert len(seen) == 8
    assert not any(photograph[..., 48:].any() for _, photograph in seen)
    # Of windows at training views; artificial ones are black where no geometry is.
    assert sum(not render[..., 48:].any() for render, _ in seen) >= 2
    assert all((render == 0).all(1).any() for render, _ in seen)


def test_an_artificial_view_of_masked_photographs_counts_where_geometry_is(
    masked: Scene, tmp_path: Path
) -> None:
    scene, config, renderer, fit = begin(masked, ADVERSARIAL, tmp_path, None)
    example = Member(tmp_path, scene, config, renderer, fit).example(None, 3)
    assert example.mask is not None
    assert example.mask.shape == (example.camera.height, example.camera.width)
    assert isinstance(example.sight, list)
    face = example.sight[0].levels[0].face
    assert face is not None
    covered = face[: example.camera.height, : example.camera.width] >= 0
    assert bool((example.mask | ~covered).all())
    assert 0 < example.mask.float().mean() < 1


def test_without_l_rec_colours_are_compared() -> None:
    (paper,) = PRESETS["paper"].stages
    alone = without_perceptual(paper)
    assert (alone.l1, alone.perceptual, alone.adversarial) == (1.0, 0.0, 1.0)
    first, second = PRESETS["adversarial"].stages
    assert without_perceptual(first) is first
    # L_GAN is scaled by what it stands beside.
    assert _lambda(alone, None) == _lambda(first, None) == BESIDE_L1
    term = cast(PerceptualTerm, SimpleNamespace(loss=SimpleNamespace(scale=0.03)))
    assert _lambda(second, term) == 0.03
    assert _lambda(first, term) == BESIDE_L1
