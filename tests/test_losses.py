"""Losses: L1 and L_rec, with and without a mask."""

from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st

from nmbg.backbones import NETS, POOLS
from nmbg.errors import NmbgError
from nmbg.losses import PAPER_LAYERS, Perceptual, l1, parse_perceptual

SHARED = Path(__file__).parents[2] / "shared" / "weights"
SPEC = "vgg19:relu1_2,relu2_2,relu3_1"


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    """A folder with random VGG-19 weights up to relu3_1."""
    torch.manual_seed(0)
    stack = NETS["vgg19"].build(POOLS["max"])
    modules = torch.nn.Sequential(*stack.modules[: stack.layers["relu3_1"]])
    folder = tmp_path_factory.mktemp("weights")
    torch.save({f"features.{k}": v for k, v in modules.state_dict().items()}, folder / "vgg19_first.pth")
    return folder


@pytest.fixture(scope="module")
def perceptual(weights) -> Perceptual:
    return Perceptual(SPEC, weights)


def test_l1_of_constants():
    assert l1(torch.full((1, 3, 4, 5), 0.75), torch.full((1, 3, 4, 5), 0.25)).item() == 0.5


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_masked_l1_is_the_mean_over_the_masked_pixels(seed, channels):
    generator = torch.Generator().manual_seed(seed)
    a, b = torch.rand(2, 2, channels, 5, 4, generator=generator)
    mask = torch.rand(2, 1, 5, 4, generator=generator) < 0.5
    mask[0, 0, 0, 0] = True
    inside = mask.expand_as(a)
    torch.testing.assert_close(l1(a, b, mask), (a - b).abs()[inside].mean())


def test_masked_l1_ignores_what_is_outside():
    a, b = torch.rand(2, 1, 3, 6, 6)
    mask = torch.zeros(1, 1, 6, 6, dtype=torch.bool)
    mask[..., :3] = True
    changed = torch.where(mask, a, torch.rand(1, 3, 6, 6))
    assert l1(a, b, mask) == l1(changed, b, mask)


def test_l1_with_a_mask_of_ones_is_the_plain_mean():
    a, b = torch.rand(2, 1, 3, 6, 6)
    torch.testing.assert_close(l1(a, b, torch.ones(1, 1, 6, 6)), l1(a, b))


def test_l1_with_an_empty_mask_is_zero_with_zero_gradient():
    a = torch.rand(1, 3, 4, 4, requires_grad=True)
    loss = l1(a, torch.zeros(1, 3, 4, 4), torch.zeros(1, 1, 4, 4))
    loss.backward()
    assert loss.item() == 0
    assert a.grad is not None
    assert not a.grad.any()


def test_l1_refuses_to_broadcast():
    with pytest.raises(ValueError, match=r"\[3, 4, 4\] and \[1, 4, 4\]"):
        l1(torch.rand(3, 4, 4), torch.rand(1, 4, 4))


def test_l1_of_bfloat16_is_summed_in_float32():
    a = torch.full((1, 1, 256, 256), 1.0, dtype=torch.bfloat16)
    a[..., 0] = 0
    loss = l1(a, torch.zeros_like(a))
    assert loss.dtype == torch.float32
    torch.testing.assert_close(loss.item(), 255 / 256, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("spec", "layers"),
    [("vgg19", PAPER_LAYERS), (SPEC, ("relu1_2", "relu2_2", "relu3_1")), ("vgg19: relu1_1", ("relu1_1",))],
)
def test_specifications(spec, layers):
    assert parse_perceptual(spec) == layers


@pytest.mark.parametrize(
    "spec", ["", "vgg16", "vgg19:", "vgg19:relu1_1,", "vgg19:" + ",".join(["relu1_1"] * 6)]
)
def test_malformed_specifications(spec):
    with pytest.raises(NmbgError, match=r"--perceptual .*expected none, vgg19"):
        parse_perceptual(spec)


def test_missing_layers_are_told_before_training(weights):
    with pytest.raises(NmbgError, match=r"relu3_2 of vgg19 needs.*up to relu3_1"):
        Perceptual("vgg19", weights)


def test_identical_images_have_no_distance(perceptual):
    image = torch.rand(1, 3, 24, 20)
    assert perceptual(image, image).item() == 0


def test_distance_is_the_weighted_sum_of_mean_differences(perceptual):
    image, target = torch.rand(2, 1, 3, 24, 20)
    features, wanted = perceptual.features(image), perceptual.features(target)
    expected = sum(w * F.l1_loss(a, b) for w, a, b in zip((1.0, 0.75, 0.5), features, wanted, strict=True))
    torch.testing.assert_close(perceptual.distance(features, wanted), expected)
    torch.testing.assert_close(perceptual(image, target), expected)


def test_gradient_reaches_every_pixel_and_no_weight(perceptual):
    image = torch.rand(1, 3, 24, 20, requires_grad=True)
    perceptual(image, torch.rand(1, 3, 24, 20)).backward()
    assert image.grad is not None
    assert (image.grad != 0).any(dim=1).all()
    assert all(p.grad is None for p in perceptual.parameters())


def test_descent_along_the_gradient_lowers_the_loss(perceptual):
    image = torch.rand(1, 3, 24, 20, requires_grad=True)
    target = torch.rand(1, 3, 24, 20)
    loss = perceptual(image, target)
    (gradient,) = torch.autograd.grad(loss, image)
    assert perceptual(image - 1e-2 * gradient / gradient.abs().max(), target) < loss


def test_mask_of_ones_changes_nothing(perceptual):
    image, target = torch.rand(2, 1, 3, 24, 20)
    torch.testing.assert_close(perceptual(image, target, torch.ones(1, 1, 24, 20)), perceptual(image, target))


def test_masked_distance_does_not_depend_on_the_masked_share(perceptual):
    # Constant features differ by the same everywhere, so the mean over any mask is the same.
    features = [torch.full((1, c, s, s), 1.0) for c, s in ((64, 32), (128, 16), (256, 8))]
    target = [torch.zeros_like(f) for f in features]
    mask = torch.zeros(1, 1, 32, 32)
    mask[..., 3:14, 5:9] = 1
    torch.testing.assert_close(perceptual.distance(features, target, mask).item(), 1 + 0.75 + 0.5)


def test_difference_far_from_the_mask_does_not_count(perceptual):
    image = torch.rand(1, 3, 64, 64)
    other = image.clone()
    other[..., 48:] = 0
    mask = torch.zeros(1, 1, 64, 64)
    mask[..., :24] = 1
    assert perceptual(other, image, mask).item() == 0
    assert perceptual(other, image, 1 - mask).item() > 0


def test_autocast_and_channels_last(perceptual):
    image, target = torch.rand(2, 1, 3, 32, 32)
    expected = perceptual(image, target)
    image = image.contiguous(memory_format=torch.channels_last).requires_grad_()
    with torch.autocast("cpu", torch.bfloat16):
        loss = perceptual(image, target)
    loss.backward()
    assert loss.dtype == torch.float32
    assert image.grad is not None
    assert image.grad.isfinite().all()
    torch.testing.assert_close(loss, expected, rtol=0.02, atol=0)


def test_scale_is_that_of_the_features(weights):
    """The adversarial term is weighted by it, so that it keeps its share whatever the weights."""
    plain, larger = Perceptual(SPEC, weights), Perceptual(SPEC, weights)
    with torch.no_grad():
        weight_1, bias_1, _, bias_2 = list(larger.network.parameters())[:4]
        for parameter in (weight_1, bias_1, bias_2):
            parameter.mul_(3)
    assert larger.scale == pytest.approx(3 * plain.scale)
    assert plain.scale > 0
    assert Perceptual("vgg19:relu2_2", weights).scale == 1


@pytest.mark.skipif(not SHARED.is_dir(), reason="the pretrained weights are not there")
def test_scale_of_the_papers_weights_is_one():
    assert Perceptual("vgg19:relu1_2", SHARED).scale == pytest.approx(1, rel=1e-3)
