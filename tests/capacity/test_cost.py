"""What a frame costs, counted by hand."""

from dataclasses import replace
from pathlib import Path

from nmbg.capacity.cost import multiply_adds, network_multiply_adds
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene
from nmbg.training.config import PRESETS


def test_multiply_adds_of_a_network_by_hand(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    model = replace(PRESETS["nmbg"].model, widths=(8, 16))
    renderer = Renderer(model, [scene.mesh])
    camera = scene.test[0].camera
    pixels, features = camera.width * camera.height, 28
    assert network_multiply_adds(renderer, camera) == 9 * pixels * (features * 8 + 8 * 16 + 16 * 8)
    assert multiply_adds(renderer, camera) > network_multiply_adds(renderer, camera)
    plain = Renderer(replace(model, widths=()), [scene.mesh])
    assert network_multiply_adds(plain, camera) == 0


def test_multiply_adds_of_a_u_net_by_hand(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    model = replace(PRESETS["npbg"].model, widths=(8, 32))
    renderer = Renderer(model, [scene.mesh])
    camera = renderer.padded(scene.test[0].camera)
    pixels, features = camera.width * camera.height, 8
    fine = 9 * features * 16 + 9 * 32 * 8 + 9 * 16 * 16 + 8 * 3  # start, up, merge, out
    coarse = 9 * 8 * 2 * (32 - features)
    assert network_multiply_adds(renderer, camera) == pixels * fine + pixels // 4 * coarse
