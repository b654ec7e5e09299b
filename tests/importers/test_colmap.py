from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from nmbg.errors import NmbgError
from nmbg.images import read_image, resize, undistort, write_image
from nmbg.importers import Capture, read_capture


def same_cameras(a: Capture, b: Capture) -> bool:
    return [p.name for p in a.photos] == [p.name for p in b.photos] and all(
        np.allclose(p.camera.projection, q.camera.projection, rtol=1e-12)
        for p, q in zip(a.photos, b.photos, strict=True)
    )


def test_the_usual_layout_is_found(workspace: Path) -> None:
    capture = read_capture(workspace)
    assert [photo.name for photo in capture.photos] == [f"{i:03d}.png" for i in range(14)]
    assert capture.images.resolve() == workspace / "images"
    assert capture.mesh == workspace / "meshed-delaunay.ply"
    assert capture.unregistered == capture.absent == ()


def test_text_and_binary_models_agree(workspace: Path) -> None:
    binary = read_capture(workspace)
    model = workspace / "sparse" / "0"
    reconstruction = pycolmap.Reconstruction(model)
    shutil.rmtree(model)
    model.mkdir()
    reconstruction.write_text(model)
    assert same_cameras(read_capture(workspace), binary)


def test_the_three_files_of_old_models_are_enough(workspace: Path) -> None:
    """Before rigs, images.txt held each image's own pose, and that was all."""
    with_rigs = read_capture(workspace)
    model = workspace / "sparse" / "0"
    reconstruction = pycolmap.Reconstruction(model)
    shutil.rmtree(model)
    model.mkdir()
    reconstruction.write_text(model)
    (model / "rigs.txt").unlink()
    (model / "frames.txt").unlink()
    assert same_cameras(read_capture(workspace), with_rigs)


@pytest.mark.parametrize("place", [".", "sparse", "sparse/3", "dense/sparse", "dense/0/sparse"])
def test_models_are_found_at_every_usual_place(place: str, workspace: Path) -> None:
    model = shutil.move(workspace / "sparse" / "0", workspace / "model")
    shutil.rmtree(workspace / "sparse")
    for file in Path(model).iterdir():
        (workspace / place).mkdir(parents=True, exist_ok=True)
        file.rename(workspace / place / file.name)
    capture = read_capture(workspace)
    assert len(capture.photos) == 14
    assert capture.mesh is not None


@pytest.mark.parametrize("place", ["sparse", "sparse/0"])
def test_the_folder_of_the_model_itself_will_do(place: str, workspace: Path) -> None:
    capture = read_capture(workspace / place)
    assert len(capture.photos) == 14
    assert capture.mesh is not None


def test_the_largest_of_several_models_is_taken(workspace: Path) -> None:
    small = pycolmap.Reconstruction(workspace / "sparse" / "0")
    for frame in list(small.reg_frame_ids())[4:]:
        small.deregister_frame(frame)
    (workspace / "sparse" / "0").rename(workspace / "sparse" / "1")
    (workspace / "sparse" / "0").mkdir()
    small.write_binary(workspace / "sparse" / "0")
    capture = read_capture(workspace)
    assert len(capture.photos) == 14
    assert capture.description.endswith("sparse/1")


def test_unregistered_and_absent_images_are_named(workspace: Path) -> None:
    (workspace / "images" / "003.png").rename(workspace / "images" / "extra.png")
    (workspace / "images" / "notes.txt").write_text("not an image")
    capture = read_capture(workspace)
    assert capture.unregistered == ("extra.png",)
    assert capture.absent == ("003.png",)
    assert len(capture.photos) == 13


def test_images_may_lie_elsewhere(workspace: Path, tmp_path: Path) -> None:
    (workspace / "images").rename(tmp_path / "elsewhere")
    with pytest.raises(NmbgError, match="--images"):
        read_capture(workspace)
    assert (
        read_capture(workspace, tmp_path / "elsewhere").photos[0].path == tmp_path / "elsewhere" / "000.png"
    )
    with pytest.raises(NmbgError, match="holds none of the model's images"):
        read_capture(workspace, workspace / "sparse")


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL_FISHEYE", "OPENCV"])
def test_reduced_copies_of_the_images_scale_the_camera_exactly(
    model: str, make_workspace: Callable[..., Path], tmp_path: Path
) -> None:
    """32 × 24 of 64 × 48 halves everything; 32 × 23 has two different scales, and both must hold."""
    workspace = make_workspace(tmp_path / "capture", model)
    K = read_capture(workspace).photos[0].camera.K
    lens = next(iter(pycolmap.Reconstruction(workspace / "sparse" / "0").cameras.values()))
    for height in (24, 23):
        for path in (workspace / "images").iterdir():
            write_image(path, resize(read_image(path), 32, height))
        photo = read_capture(workspace).photos[0]
        assert photo.camera.K[0, 0] == pytest.approx(K[0, 0] / 2, rel=1e-9)
        assert photo.camera.K[1, 1] == pytest.approx(K[1, 1] * height / 48, rel=1e-9)
        if photo.lens is not None:
            ray = np.array([[0.2, -0.1, 1.0]])
            expected = np.asarray(lens.img_from_cam(ray)) * [0.5, height / 48]
            assert np.allclose(photo.lens.img_from_cam(ray), expected, atol=1e-6)


def test_images_of_another_shape_are_refused(workspace: Path) -> None:
    path = workspace / "images" / "004.png"
    write_image(path, resize(read_image(path), 48, 48))
    with pytest.raises(NmbgError, match=r"004\.png: 48×48 pixels, but its camera has 64×48"):
        read_capture(workspace)


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "FULL_OPENCV", "FOV", "THIN_PRISM_FISHEYE"])
def test_undistorted_photographs_are_what_the_pinhole_camera_would_take(
    model: str, make_workspace: Callable[..., Path], tmp_path: Path
) -> None:
    distorted = read_capture(make_workspace(tmp_path / "distorted", model)).photos[2]
    K, size = distorted.camera.K, (distorted.camera.width, distorted.camera.height)
    pinhole = pycolmap.Camera(
        model="PINHOLE",
        width=size[0],
        height=size[1],
        params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        camera_id=1,
    )
    straight = make_workspace(tmp_path / "straight", camera=pinhole)
    truth = read_image(straight / "images" / distorted.name).astype(float)
    undistorted = undistort(read_image(distorted.path), distorted.lens).astype(float)
    assert undistorted.shape == truth.shape
    assert np.median(np.abs(undistorted - truth)) < 3
    raw = resize(read_image(distorted.path), truth.shape[1], truth.shape[0]).astype(float)
    assert np.mean((undistorted - truth) ** 2) < 0.5 * np.mean((raw - truth) ** 2)


def test_a_panorama_is_refused(workspace: Path) -> None:
    model = workspace / "sparse" / "0"
    reconstruction = pycolmap.Reconstruction(model)
    shutil.rmtree(model)
    model.mkdir()
    reconstruction.write_text(model)
    (model / "cameras.txt").write_text("1 EQUIRECTANGULAR 64 48 64 48\n")
    with pytest.raises(NmbgError, match="panorama"):
        read_capture(workspace)


def test_folders_without_a_capture_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="no such folder"):
        read_capture(tmp_path / "nothing")
    with pytest.raises(NmbgError, match="no cameras found"):
        read_capture(tmp_path)


@pytest.mark.parametrize("kept", [0, 4, 20, 0.5, -3])
@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"])
def test_models_that_were_cut_off_are_refused(file: str, kept: float, workspace: Path) -> None:
    path = workspace / "sparse" / "0" / file
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content)) if kept == 0.5 else int(kept)])
    with pytest.raises(NmbgError, match=rf"{file}: damaged or truncated"):
        read_capture(workspace)


def test_models_that_contradict_themselves_are_refused(workspace: Path) -> None:
    model = workspace / "sparse" / "0"
    (model / "cameras.bin").write_bytes(b"\0" * 8)  # no camera at all
    with pytest.raises(NmbgError, match="damaged COLMAP model"):
        read_capture(workspace)


def test_a_model_that_registers_nothing_is_refused(workspace: Path) -> None:
    model = workspace / "sparse" / "0"
    empty = pycolmap.Reconstruction()
    empty.write_binary(model)
    with pytest.raises(NmbgError, match="registers no image"):
        read_capture(workspace)
