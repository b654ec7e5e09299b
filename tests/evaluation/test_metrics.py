"""Metrics against closed forms, independent implementations and documented values."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torchmetrics.functional.image import structural_similarity_index_measure

from nmbg.errors import NmbgError
from nmbg.evaluation import LPIPS_NETS, METRICS, higher_is_better
from nmbg.evaluation.metrics import LPIPS, LPIPS_LAYERS, make_metrics, psnr, ssim, ssim_svs

WEIGHTS = Path(__file__).parents[2].parent / "shared" / "weights"


def photo_and_estimate(seed: int, height: int = 40, width: int = 53) -> tuple[np.ndarray, np.ndarray]:
    """A smooth random image and a noisy, darkened version of it, [H, W, 3] float64 in [0, 1]."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / 10
    waves = rng.uniform(0.3, 3, (3, 4))
    photo = np.stack([np.sin(a * x + b) * np.cos(c * y + d) for a, b, c, d in waves], axis=-1) / 2 + 0.5
    estimate = np.clip(0.9 * photo + rng.normal(0, rng.uniform(0.01, 0.2), photo.shape), 0, 1)
    return photo, estimate


def tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image).permute(2, 0, 1)


def test_psnr_closed_form():
    estimate = torch.zeros(3, 4, 5)
    for error, decibels in ((1.0, 0.0), (0.1, 20.0), (0.01, 40.0)):
        assert psnr(estimate + error, estimate) == pytest.approx(decibels, abs=1e-5)


def test_psnr_of_identical_images_is_infinite():
    image = torch.rand(3, 4, 5)
    assert psnr(image, image) == math.inf


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_psnr_agrees_with_scikit_image(seed):
    photo, estimate = photo_and_estimate(seed)
    expected = peak_signal_noise_ratio(photo, estimate, data_range=1)
    assert psnr(tensor(estimate), tensor(photo)) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ssim_agrees_with_scikit_image(seed):
    photo, estimate = photo_and_estimate(seed)
    # scikit-image leaves out the 5 pixels at the border: with a reflection there, it counts the whole image.
    padded = [np.pad(image, ((5, 5), (5, 5), (0, 0)), mode="reflect") for image in (photo, estimate)]
    expected = structural_similarity(
        *padded, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=2
    )
    assert ssim(tensor(estimate), tensor(photo)) == pytest.approx(expected, abs=1e-9)


def test_ssim_agrees_with_torchmetrics():
    photo, estimate = map(tensor, photo_and_estimate(2))
    # The mean of its map: its own mean left the border out until 2024.
    _, similarity = structural_similarity_index_measure(
        estimate[None], photo[None], sigma=1.5, data_range=1.0, return_full_image=True
    )
    assert ssim(estimate, photo) == pytest.approx(similarity.mean().item(), abs=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_ssim_svs_agrees_with_scikit_image(seed):
    photo, estimate = photo_and_estimate(seed)
    # The defaults of the scikit-image that FVS used: window 7, sample covariance, range 2 for floats.
    expected = structural_similarity(photo, estimate, win_size=7, data_range=2, channel_axis=2)
    assert ssim_svs(tensor(estimate), tensor(photo)) == pytest.approx(expected, abs=1e-9)


def test_ssim_svs_flatters():
    photo, estimate = photo_and_estimate(3)
    assert ssim_svs(tensor(estimate), tensor(photo)) > ssim(tensor(estimate), tensor(photo)) + 0.03


@pytest.mark.parametrize("metric", [ssim, ssim_svs])
def test_identical_images_are_wholly_similar(metric):
    image = torch.rand(3, 20, 20)
    assert metric(image, image) == pytest.approx(1)


@pytest.mark.parametrize("metric", [psnr, ssim, ssim_svs])
def test_metrics_are_symmetric(metric):
    photo, estimate = map(tensor, photo_and_estimate(5))
    assert metric(photo, estimate) == pytest.approx(metric(estimate, photo), abs=1e-12)


@pytest.mark.parametrize("metric", [psnr, ssim, ssim_svs])
def test_images_of_other_sizes_are_refused(metric):
    with pytest.raises(ValueError, match=r"\[3, 20, 20\] and \[3, 20, 21\]"):
        metric(torch.rand(3, 20, 20), torch.rand(3, 20, 21))


def test_metrics_are_named_with_their_settings():
    named = make_metrics(("ssim_svs", "psnr", "ssim", "psnr"))
    assert [m.name for m in named] == ["ssim_svs", "psnr", "ssim"]
    assert all(m.settings for m in named)
    with pytest.raises(ValueError, match="unknown metric sharpness"):
        make_metrics(("sharpness",))


def test_every_announced_metric_exists():
    assert set(METRICS) == {"psnr", "ssim", "ssim_svs", "lpips"}
    assert set(LPIPS_NETS) == set(LPIPS_LAYERS)


def test_foreign_heads_are_refused(tmp_path):
    (tmp_path / "lpips").mkdir()
    torch.save({"lin0.model.1.weight": torch.ones(1, 64, 1, 1)}, tmp_path / "lpips" / "squeeze.pth")
    with pytest.raises(NmbgError, match=r"squeeze.pth: not the LPIPS v0.1 heads of squeeze"):
        LPIPS("squeeze", tmp_path)


@pytest.fixture(scope="module")
def squeeze() -> LPIPS:
    if not (WEIGHTS / "squeezenet1_1.pth").is_file():
        pytest.skip(f"no weights in {WEIGHTS}")
    return LPIPS("squeeze", WEIGHTS)


@pytest.mark.captures
def test_lpips_gives_torchmetrics_documented_values(squeeze):
    torch.manual_seed(123)
    a, b = torch.rand(10, 3, 100, 100), torch.rand(10, 3, 100, 100)
    assert squeeze(a, b).mean().item() == pytest.approx(0.1008, abs=5e-5)
    generator = torch.Generator().manual_seed(42)
    a, b = (torch.rand(2, 3, 100, 100, generator=generator) for _ in range(2))
    assert squeeze(a, b).tolist() == pytest.approx([0.1024, 0.0938], abs=5e-5)


@pytest.mark.captures
def test_lpips_knows_nothing_better_than_equality(squeeze):
    photo, estimate = photo_and_estimate(1, 64, 48)
    image, blurred = tensor(photo)[None].float(), tensor(estimate)[None].float()
    assert squeeze(image, image).item() == 0
    assert squeeze(image, blurred).item() == pytest.approx(squeeze(blurred, image).item(), rel=1e-5)
    assert 0 < squeeze(image, 0.5 * (image + blurred)).item() < squeeze(image, blurred).item()


@pytest.mark.captures
def test_lpips_metric_carries_its_network(squeeze):
    (metric,) = make_metrics(("lpips",), "squeeze", WEIGHTS)
    a, b = torch.rand(2, 3, 40, 40)
    assert metric.name == "lpips_squeeze"
    assert not higher_is_better(metric.name)
    assert metric.compute(a, b) == pytest.approx(squeeze(a[None], b[None]).item())
