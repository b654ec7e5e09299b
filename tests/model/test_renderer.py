from dataclasses import replace

import numpy as np
import pytest
import torch

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.model.config import ModelConfig
from nmbg.model.renderer import Renderer
from nmbg.ops import rasterize_faces, rasterize_points, shade_faces, shade_points

COLOUR = ModelConfig(degree=2, features=3, points=False, widths=())
NETWORK = ModelConfig(degree=1, features=4, widths=(12, 24, 36))


def randomised(renderer: Renderer) -> Renderer:
    torch.manual_seed(1)
    for parameter in renderer.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return renderer


def test_colour_equals_shading_the_whole_mesh(bumpy: Mesh, camera: Camera) -> None:
    """Fragments are renumbered to what a view sees; the picture must not know."""
    renderer = randomised(Renderer(COLOUR, [bumpy]))
    faces = torch.from_numpy(bumpy.faces)
    face, bary, _ = rasterize_faces(camera.project(torch.from_numpy(bumpy.vertices)), faces, 30, 43)
    coeffs = renderer.descriptors[0].coeffs.view(-1, 9, 3)
    expected = shade_faces(face, bary, faces, camera.rays(), coeffs) + 0.5
    torch.testing.assert_close(renderer(renderer.rasterize(camera), camera), expected)


def test_pyramid_equals_every_level_shaded_alone(bumpy: Mesh, camera: Camera) -> None:
    descriptors = randomised(Renderer(NETWORK, [bumpy])).descriptors[0]
    (fragments,) = Renderer(NETWORK, [bumpy]).rasterize(camera)
    padded, vertices = camera.padded(4), torch.from_numpy(bumpy.vertices)
    radius = 0.006 * camera.height / 2
    assert (padded.width, padded.height) == (44, 32)
    coeffs = descriptors.coeffs.view(-1, 4, 4)
    for k, image in enumerate(descriptors.pyramid(fragments, 3)):
        level = padded.level(k)
        index, dist2 = rasterize_points(level.project(vertices), radius, level.height, level.width)
        face, bary, _ = rasterize_faces(
            level.project(vertices), torch.from_numpy(bumpy.faces), level.height, level.width
        )
        points = shade_points(index, 1 - dist2 / radius**2, level.rays(), coeffs)
        through_faces = shade_faces(face, bary, torch.from_numpy(bumpy.faces), level.rays(), coeffs)
        torch.testing.assert_close(image[0], torch.cat([through_faces, points]))


def test_gradient_reaches_only_what_the_view_sees(bumpy: Mesh, camera: Camera) -> None:
    renderer = randomised(Renderer(NETWORK, [bumpy]))
    narrow = camera.cropped(15, 10, 8, 6)
    fragments = renderer.rasterize(narrow)
    renderer(fragments, narrow).sum().backward()
    gradient = renderer.descriptors[0].coeffs.grad
    assert gradient is not None
    assert gradient.is_sparse
    assert 0 < gradient._nnz() < len(bumpy.vertices) / 2


def test_supersampling_averages_the_samples(bumpy: Mesh, camera: Camera) -> None:
    fine = randomised(Renderer(replace(COLOUR, supersample=4), [bumpy]))
    plain = randomised(Renderer(COLOUR, [bumpy]))
    large = camera.resized(4 * camera.width, 4 * camera.height)
    expected = torch.nn.functional.avg_pool2d(plain(plain.rasterize(large), large), 4)
    torch.testing.assert_close(fine(fine.rasterize(camera), camera), expected)


def test_supersampled_pyramid_is_the_average_of_its_finest_level(bumpy: Mesh, camera: Camera) -> None:
    config = replace(NETWORK, supersample=2, points=False)
    renderer = randomised(Renderer(config, [bumpy]))
    (fragments,) = renderer.rasterize(camera)
    finest, *coarser = renderer.descriptors[0].pyramid(fragments, 3)
    assert [tuple(level.shape[-2:]) for level in (finest, *coarser)] == [(32, 44), (16, 22), (8, 11)]
    torch.testing.assert_close(coarser[1], torch.nn.functional.avg_pool2d(finest, 4))


def test_foreground_hides_background(bumpy: Mesh, camera: Camera) -> None:
    behind = replace(bumpy, vertices=bumpy.vertices * 2 + np.float32([0, 0, 2]))
    renderer = randomised(Renderer(replace(COLOUR, layers=2), [bumpy, behind]))
    alone = [Renderer(COLOUR, [mesh]) for mesh in (bumpy, behind)]
    for single, descriptors in zip(alone, renderer.descriptors, strict=True):
        single.descriptors[0].load_state_dict(descriptors.state_dict())
    front, back = (single(single.rasterize(camera), camera) for single in alone)
    covered = alone[0].rasterize(camera)[0].levels[0].face >= 0
    assert 0 < covered.float().mean() < 1
    expected = torch.where(covered, front, back)
    torch.testing.assert_close(renderer(renderer.rasterize(camera), camera), expected)


@pytest.mark.parametrize("size", [(43, 30), (1, 1), (64, 48)])
def test_render_any_size_is_an_image(bumpy: Mesh, camera: Camera, size: tuple[int, int]) -> None:
    renderer = randomised(Renderer(NETWORK, [bumpy]))
    image = renderer.render(camera.resized(*size))
    assert image.shape == (3, size[1], size[0])
    assert image.dtype == torch.float32
    assert image.min() >= 0
    assert image.max() <= 1
    assert image.isfinite().all()


def test_bfloat16_changes_a_view_by_about_a_byte(bumpy: Mesh, camera: Camera) -> None:
    torch.manual_seed(1)
    renderer = Renderer(NETWORK, [bumpy])
    torch.nn.init.normal_(renderer.descriptors[0].coeffs, std=0.3)
    exact = renderer.render(camera)
    renderer.bf16 = True
    rounded = renderer.render(camera)
    assert rounded.dtype == torch.float32
    assert 0 < (rounded - exact).square().mean().sqrt() < 1 / 255


def test_looking_away_is_plain(bumpy: Mesh, camera: Camera) -> None:
    away = replace(camera, R=np.diag([1.0, -1.0, -1.0]), t=np.array([0.0, 0, -3]))
    image = Renderer(COLOUR, [bumpy]).render(away)
    torch.testing.assert_close(image, torch.full((3, 30, 43), 0.5))


def test_a_network_shows_a_plain_frame_of_nothing(bumpy: Mesh, camera: Camera) -> None:
    """Its convolutions know where the frame ends, and would draw that."""
    renderer = randomised(Renderer(NETWORK, [bumpy]))
    away = replace(camera, R=np.diag([-1.0, 1, -1]) @ camera.R, t=np.array([0.0, 0, -3]))
    drawn = renderer(renderer.see(away), away)
    assert drawn.flatten(1).std(1).max() > 1e-3
    assert (renderer.render(away) == 0.5).all()


def test_config_refuses_nonsense() -> None:
    with pytest.raises(ValueError, match="faces, points or both"):
        ModelConfig(faces=False, points=False)
    with pytest.raises(ValueError, match="supersampled"):
        ModelConfig(supersample=2)
    with pytest.raises(ValueError, match=r"supersample: .*got 3"):
        ModelConfig(supersample=3, points=False)
    for changes in ({}, {"features": 3}, {"faces": False, "features": 3}, {"points": False}):
        with pytest.raises(ValueError, match="without a U-Net"):
            ModelConfig(widths=(), **changes)
        with pytest.raises(ValueError, match="without a U-Net"):
            ModelConfig(sources=5, **changes)
    with pytest.raises(ValueError, match="one layer"):
        replace(COLOUR, sources=5, layers=2)


@pytest.mark.parametrize(("size", "radius"), [((1920, 1080), 3.24), ((976, 544), 1.632), ((1600, 1200), 3.6)])
def test_point_radius_of_the_paper(size: tuple[int, int], radius: float) -> None:
    assert ModelConfig().radius_px(*size) == pytest.approx(radius)
    assert ModelConfig(point_radius=None).radius_px(*size) == 0.5


def test_hidden_points_are_missing_on_every_level(bumpy: Mesh, camera: Camera) -> None:
    """A point is there on all levels or on none, faces stay, and the rest is as it was."""
    (whole,) = Renderer(NETWORK, [bumpy]).rasterize(camera)
    holed = whole.without_points(0.4, torch.Generator().manual_seed(0))
    there, gone = set[int](), set[int]()
    for before, after in zip(whole.levels, holed.levels, strict=True):
        assert before.index is not None
        assert after.index is not None
        assert before.weight is not None
        assert after.weight is not None
        assert after.face is before.face
        shown = after.index >= 0
        assert torch.equal(after.index[shown], before.index[shown])
        assert torch.equal(after.weight, before.weight * shown)
        there |= set(after.index[shown].tolist())
        gone |= set(before.index[~shown & (before.index >= 0)].tolist())
    assert not there & gone
    assert 0.3 < len(gone) / len(there | gone) < 0.5
