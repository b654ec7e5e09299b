from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nmbg.capacity.storage import STORAGES, SUFFIX, Storage, store, stored_bytes
from nmbg.images import can_write, write_image
from nmbg.scene import Scene

needs_writer = pytest.mark.skipif(not can_write(SUFFIX), reason="OpenImageIO has no JPEG XL here")


def test_as_they_are_means_the_same_bytes(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    assert store(scene, scene.train, tmp_path, STORAGES[-1]) == scene.train
    for view in scene.train:
        place = Path("images") / view.image
        assert (tmp_path / place).read_bytes() == (scene.folder / place).read_bytes()


@needs_writer
def test_lower_quality_takes_fewer_bytes_and_lossless_loses_nothing(
    scene_folder: Path, tmp_path: Path
) -> None:
    scene, sizes, errors = Scene.load(scene_folder), [], []
    for quality in (75, 95, 100):
        place = tmp_path / str(quality)
        (stored,) = store(scene, scene.train[:1], place, Storage(quality))
        sizes.append(stored_bytes(place))
        images = [replace(scene, folder=place).load_image(stored), scene.load_image(scene.train[0])]
        errors.append(np.abs(images[0].astype(int) - images[1]).mean())
    assert sizes[0] < sizes[1] < sizes[2]
    assert errors[0] > errors[1] > errors[2] == 0


@needs_writer
def test_halved_photographs_keep_their_field_of_view_and_mask(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    view = scene.train[0]
    masked = tmp_path / "masked"
    (masked / "masks").mkdir(parents=True)
    mask = np.zeros((view.camera.height, view.camera.width), np.uint8)
    mask[:, : view.camera.width // 2] = 255
    write_image(masked / "masks" / "mask.png", mask)
    (masked / "images").symlink_to(scene.folder / "images")
    scene = replace(scene, folder=masked)
    (stored,) = store(scene, [replace(view, mask="mask.png")], tmp_path / "out", Storage(90, halvings=1))
    camera, small = view.camera, stored.camera
    assert (small.width, small.height) == (camera.width // 2, camera.height // 2)
    assert np.isclose(small.K[0, 0] / small.width, camera.K[0, 0] / camera.width)
    loaded = replace(scene, folder=tmp_path / "out")
    assert loaded.load_image(stored).shape == (small.height, small.width, 3)
    kept = loaded.load_mask(stored)
    assert kept is not None
    assert 0.45 < kept.mean() < 0.55
