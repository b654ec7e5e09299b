from pathlib import Path

import numpy as np
import pytest
import torch

from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.views import Views


@pytest.fixture
def views(scene_folder: Path) -> Views:
    scene = Scene.load(scene_folder)
    renderer = Renderer(PRESETS["mesh"].model, [scene.mesh])
    return Views(scene, scene.train, lambda camera, _: renderer.rasterize(camera), 0.0)


def test_whole_window_is_the_frame(views: Views) -> None:
    frame, window = views.frame(0), views.window(0, 1.0, (1.0, 1.0), torch.Generator().manual_seed(0))
    assert torch.equal(frame.image, window.image)
    np.testing.assert_allclose(frame.camera.K, window.camera.K)


@pytest.mark.parametrize("seed", range(5))
def test_crop_shows_the_part_of_the_frame_that_its_camera_says(scene_folder: Path, seed: int) -> None:
    scene = Scene.load(scene_folder)
    renderer = Renderer(PRESETS["nmbg"].model, [scene.mesh])
    renderer.remember(scene, scene.train)
    views = Views(scene, scene.train, lambda camera, view: renderer.see(camera, view.name), 1.0)
    frame = views.frame(1)
    crop = views.crop(1, 0.5, torch.Generator().manual_seed(seed))
    assert (crop.camera.width, crop.camera.height) == (32, 24)
    x0, y0 = (round(c) for c in frame.camera.K[:2, 2] - crop.camera.K[:2, 2])
    assert torch.equal(crop.image, frame.image[:, y0 : y0 + 24, x0 : x0 + 32])
    assert torch.equal(crop.sight.base, frame.sight.base[:, y0 : y0 + 24, x0 : x0 + 32])
    assert renderer(crop.sight, crop.camera).shape == crop.image.shape


@pytest.mark.parametrize("seed", range(5))
def test_window_moves_camera_and_photograph_alike(
    views: Views, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A photograph that holds its own pixel coordinates says where a window's pixels come from."""
    camera = views.views[0].camera
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    coordinates = np.stack([x, y, 0 * x], -1)
    monkeypatch.setattr(Scene, "load_image", lambda *_: coordinates.astype(np.uint8))
    window = views.window(0, 0.5, (0.5, 2.0), torch.Generator().manual_seed(seed))
    assert (window.camera.width, window.camera.height) == (round(camera.width / 2), round(camera.height / 2))
    # The same ray through both cameras: K_frame K_window⁻¹ maps window pixels to frame pixels.
    to_frame = camera.K @ np.linalg.inv(window.camera.K)
    i, j = 5, 9
    u, v, w = to_frame @ [j + 0.5, i + 0.5, 1]
    assert w == pytest.approx(1)
    # uint8 truncates the centres' +0.5 and the result is rounded: within one pixel.
    assert window.image[0, i, j].item() == pytest.approx(u - 0.5, abs=0.75)
    assert window.image[1, i, j].item() == pytest.approx(v - 0.5, abs=0.75)
