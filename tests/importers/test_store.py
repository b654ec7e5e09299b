from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmbg.cameras import Camera
from nmbg.errors import NmbgError
from nmbg.images import read_image, read_mask, write_image
from nmbg.importers import Photo
from nmbg.importers.store import find_masks, store_photograph

IMAGE = np.random.default_rng(0).integers(0, 256, (48, 64, 3)).astype(np.uint8)


def camera(width: int = 64, height: int = 48) -> Camera:
    K = np.array([[60.0, 0, 32.7], [0, 61.0, 23.6], [0, 0, 1]])
    return Camera(K, np.eye(3), np.zeros(3), width, height)


@pytest.fixture
def photo(tmp_path: Path) -> Photo:
    write_image(tmp_path / "a.png", IMAGE)
    return Photo("a.png", tmp_path / "a.png", camera(), None)


@given(width=st.integers(1, 5000), height=st.integers(1, 5000), most=st.integers(1, 2000))
def test_the_longer_side_is_limited_and_the_camera_follows(width: int, height: int, most: int) -> None:
    full = camera(width, height)
    small = full.within(most)
    assert max(small.width, small.height) == min(most, max(width, height))
    expected = np.diag([small.width / width, small.height / height, 1]) @ full.K
    assert np.allclose(small.K, expected, rtol=1e-14)
    assert full.within(max(width, height)) is full


def test_photographs_that_need_no_change_are_copied(photo: Photo, tmp_path: Path) -> None:
    stored, image, mask = store_photograph(photo, None, tmp_path, "00007", max_size=64)
    assert stored is photo.camera
    assert (image, mask) == ("00007.png", None)
    assert (tmp_path / "images" / image).read_bytes() == photo.path.read_bytes()


def test_larger_photographs_are_resized(photo: Photo, tmp_path: Path) -> None:
    stored, image, _ = store_photograph(photo, None, tmp_path, "00000", max_size=32)
    assert read_image(tmp_path / "images" / image).shape == (24, 32, 3) == (stored.height, stored.width, 3)


def test_masks_follow_their_photograph(photo: Photo, tmp_path: Path) -> None:
    left = np.zeros((48, 64), np.uint8)
    left[:, :32] = 255
    write_image(tmp_path / "mask.png", left)
    _, _, name = store_photograph(photo, tmp_path / "mask.png", tmp_path, "00000", max_size=32)
    assert name is not None
    mask = read_mask(tmp_path / "masks" / name)
    assert mask.shape == (24, 32)
    assert mask[:, :16].all()
    assert not mask[:, 16:].any()


def test_masks_of_another_size_are_refused(photo: Photo, tmp_path: Path) -> None:
    write_image(tmp_path / "mask.png", np.zeros((24, 32), np.uint8))
    with pytest.raises(NmbgError, match=r"mask\.png: 32×24 pixels, its image a\.png has 64×48"):
        store_photograph(photo, tmp_path / "mask.png", tmp_path, "00000", None)


@pytest.mark.parametrize("mask", ["0003.jpg.png", "0003.png", "003.png", "3.png"])
def test_masks_are_matched_by_name_stem_or_number(mask: str, tmp_path: Path) -> None:
    write_image(tmp_path / mask, np.zeros((4, 4), np.uint8))
    write_image(tmp_path / "0004.png", np.zeros((4, 4), np.uint8))
    assert find_masks(tmp_path, ["0003.jpg"]) == {"0003.jpg": tmp_path / mask}


def test_masks_in_folders_match_their_own_folder(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        write_image(tmp_path / side / "1.png", np.zeros((4, 4), np.uint8))
    found = find_masks(tmp_path, ["left/1.jpg", "right/1.jpg"])
    assert found == {f"{side}/1.jpg": tmp_path / side / "1.png" for side in ("left", "right")}


def test_missing_masks_are_named(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="no such folder of masks"):
        find_masks(tmp_path / "none", ["a.jpg"])
    with pytest.raises(NmbgError, match=r"no mask for image a\.jpg"):
        find_masks(tmp_path, ["a.jpg"])
