from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pycolmap
import pytest

from nmbg.errors import NmbgError
from nmbg.images import (
    from_bytes,
    image_size,
    read_image,
    read_mask,
    resize,
    to_bytes,
    undistort,
    undistorted_camera,
    write_image,
)


def noise(height: int = 40, width: int = 60, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, channels)).astype(np.uint8)


def test_png_keeps_every_value(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", noise())
    assert np.array_equal(read_image(tmp_path / "a.png"), noise())
    assert image_size(tmp_path / "a.png") == (60, 40)


def test_every_byte_comes_back_from_a_tensor() -> None:
    image = np.arange(3 * 256, dtype=np.int64).reshape(16, 16, 3) // 3
    tensor = from_bytes(image.astype(np.uint8))
    assert tensor.shape == (3, 16, 16)
    assert tensor.min() == 0
    assert tensor.max() == 1
    assert np.array_equal(to_bytes(tensor), image)


@pytest.mark.parametrize("channels", [1, 2, 4])
def test_other_channel_counts_become_three(channels: int, tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", noise(channels=channels))
    image = read_image(tmp_path / "a.png")
    assert image.shape == (40, 60, 3)
    if channels == 4:
        # The reader may scale colour by alpha, as the file format leaves open; opaque pixels never change.
        opaque = noise(channels=4)
        opaque[..., 3] = 255
        write_image(tmp_path / "b.png", opaque)
        assert np.array_equal(read_image(tmp_path / "b.png"), opaque[..., :3])
    else:
        assert np.array_equal(image[..., 0], image[..., 2])


def test_sixteen_bits_are_rounded_to_eight(tmp_path: Path) -> None:
    spec = oiio.ImageSpec(60, 40, 3, "uint16")
    out = oiio.ImageOutput.create(str(tmp_path / "a.png"))
    assert out.open(str(tmp_path / "a.png"), spec)
    assert out.write_image(noise().astype(np.uint16) * 257)
    out.close()
    assert np.array_equal(read_image(tmp_path / "a.png"), noise())


def test_masks_are_true_where_bright(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.array([[0, 127, 128, 255]], np.uint8))
    assert read_mask(tmp_path / "a.png").tolist() == [[False, False, True, True]]


@pytest.mark.parametrize(("width", "height"), [(23, 31), (90, 60), (60, 20), (31, 40)])
def test_resizing_is_the_lanczos_filter_of_openimageio(width: int, height: int) -> None:
    """Away from borders, which it repeats while ours weigh what there is."""
    image = noise()
    roi = oiio.ROI(0, width, 0, height, 0, 1, 0, 3)
    twin = oiio.ImageBufAlgo.resize(oiio.ImageBuf(image), filtername="lanczos3", roi=roi)
    difference = resize(image, width, height).astype(int) - twin.get_pixels(oiio.UINT8)
    assert np.abs(difference[6:-6, 6:-6]).max() <= 1


def test_resizing_keeps_borders_where_they_are() -> None:
    # A ramp along x: after halving, pixel j covers old pixels 2j and 2j + 1.
    ramp = np.tile((4 * np.arange(60)).astype(np.uint8)[None, :, None], (40, 1, 3))
    small = resize(ramp, 30, 20)
    expected = 4 * (2 * np.arange(30) + 0.5)
    assert small.shape == (20, 30, 3)
    assert np.abs(small[10, 3:-3, 0] - expected[3:-3]).max() <= 1
    assert resize(ramp, 60, 40) is ramp


def test_resizing_removes_what_the_small_image_cannot_show() -> None:
    stripes = np.zeros((64, 64, 3), np.uint8)
    stripes[:, ::2] = 255
    assert np.abs(resize(stripes, 16, 16)[4:-4, 4:-4].astype(int) - 128).max() <= 4


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
def test_truncated_images_are_errors(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    write_image(path, noise(200, 300))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(NmbgError, match="damaged or truncated"):
        read_image(path)


def test_absent_and_foreign_files_are_errors(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="no such image"):
        read_image(tmp_path / "a.png")
    (tmp_path / "b.png").write_text("not an image")
    with pytest.raises(NmbgError, match="not a readable image"):
        image_size(tmp_path / "b.png")


def test_unknown_formats_and_absent_folders_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="unknown image format"):
        write_image(tmp_path / "a.xyz", noise())
    with pytest.raises(NmbgError, match="cannot be written"):
        write_image(tmp_path / "none" / "a.png", noise())


@pytest.mark.parametrize("k", [0.15, -0.15])
def test_undistorted_photographs_show_what_their_pinhole_camera_sees(k: float) -> None:
    """What is linear in the viewing direction must be linear in the pixels once it is undistorted."""
    lens = pycolmap.Camera(model="SIMPLE_RADIAL", width=160, height=120, params=[150.0, 83.0, 57.0, k])
    u, v = np.meshgrid(np.arange(160) + 0.5, np.arange(120) + 0.5)
    direction = lens.cam_from_img(np.stack([u.ravel(), v.ravel()], 1)).reshape(120, 160, 2)
    painted = np.stack([*(128 + 180 * np.moveaxis(direction, 2, 0)), np.full((120, 160), 255.0)], axis=2)
    straight = undistort(painted.round().clip(0, 255).astype(np.uint8), lens)
    camera = undistorted_camera(lens)
    assert straight.shape == (camera.height, camera.width, 3)
    assert (straight[..., 2] == 255).all(), "no black borders"
    K = camera.calibration_matrix()
    columns = 128 + 180 * (np.arange(camera.width) + 0.5 - K[0, 2]) / K[0, 0]
    rows = 128 + 180 * (np.arange(camera.height) + 0.5 - K[1, 2]) / K[1, 1]
    assert np.abs(straight[3:-3, 3:-3, 0] - columns[3:-3]).max() < 1.5
    assert np.abs(straight[3:-3, 3:-3, 1] - rows[3:-3, None]).max() < 1.5
