"""COLMAP workspaces: binary or text models, with or without rigs, every lens that can be made a pinhole."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nmbg.cameras import Camera
from nmbg.colmap import pycolmap
from nmbg.errors import NmbgError
from nmbg.images import SUFFIXES, image_size, undistorted_camera
from nmbg.importers.capture import Capture, Photo
from nmbg.importers.colmap_files import check_complete

NAME = "COLMAP model (cameras, images, points3D as .bin or .txt)"

IMAGE_FOLDERS = ("images", "image", "photos", "rgb", "input", "")
MESH_NAMES = ("meshed-delaunay.ply", "delaunay_photometric.ply", "meshed-poisson.ply", "mesh.ply")
# In order of preference among models of equal size: a dense workspace has images and mesh beside its model.
MODEL_FOLDERS = (".", "dense/sparse", "dense/*/sparse", "sparse", "sparse/*", "dense/*", "*", "*/sparse")


def detect(source: Path) -> bool:
    """Whether a COLMAP model lies in the folder or at a usual place below it."""
    return next(_model_folders(source), None) is not None


def read(source: Path, images: Path | None) -> Capture:
    """Read the largest model of a workspace and find its photographs and mesh.

    Args:
        source: the workspace, or the folder of the model itself.
        images: where the photographs lie, when not at a usual place.

    Raises:
        NmbgError: a damaged model, one without registered images, photographs that are not found, are of
            another shape than the model says, or whose lens no pinhole can replace.
    """
    folder, model = _largest_model(source)
    registered = {model.image(i).name: model.image(i) for i in model.reg_image_ids()}
    if not registered:
        raise NmbgError(f"{folder}: the model registers no image; reconstruct the capture again")
    names = sorted(registered)
    photographs = images if images is not None else _find_images(source, folder, names)
    if not any((photographs / name).is_file() for name in names):
        raise NmbgError(
            f"{photographs}: holds none of the model's images ({names[0]}, …); give them with --images"
        )
    present = [name for name in names if (photographs / name).is_file()]
    return Capture(
        description=f"COLMAP model {folder}",
        photos=tuple(_photo(photographs / name, registered[name]) for name in present),
        images=photographs,
        unregistered=_unregistered(photographs, names),
        absent=tuple(name for name in names if name not in present),
        mesh=_find_mesh(source, folder),
    )


def _is_model(folder: Path) -> bool:
    return any(
        all((folder / f"{part}{end}").is_file() for part in ("cameras", "images")) for end in (".bin", ".txt")
    )


def _model_folders(source: Path) -> Iterator[Path]:
    for pattern in MODEL_FOLDERS:
        for folder in [source] if pattern == "." else sorted(source.glob(pattern)):
            if _is_model(folder):
                yield folder


def _largest_model(source: Path) -> tuple[Path, pycolmap.Reconstruction]:
    best: tuple[Path, pycolmap.Reconstruction] | None = None
    for folder in _model_folders(source):
        check_complete(folder)
        try:
            model = pycolmap.Reconstruction(folder)
        except Exception as error:  # pycolmap passes on whatever C++ throws
            reason = " ".join(str(error).split())
            raise NmbgError(f"{folder}: damaged COLMAP model ({reason}); copy or export it again") from error
        if best is None or model.num_reg_images() > best[1].num_reg_images():
            best = folder, model
    if best is None:
        raise NmbgError(f"{source}: no COLMAP model; reconstruct the capture first")
    return best


def _around(source: Path, model: Path) -> list[Path]:
    """Where files of a model may lie, nearest first: its folder, the two above, and the workspace."""
    resolved = model.resolve()
    folders = [resolved, *list(resolved.parents)[:2], source.resolve()]
    return list(dict.fromkeys(folders))


def _find_images(source: Path, model: Path, names: list[str]) -> Path:
    for base in _around(source, model):
        for usual in IMAGE_FOLDERS:
            folder = base / usual
            if any((folder / name).is_file() for name in names):
                return folder
    raise NmbgError(
        f"{source}: the model's images ({names[0]}, …) are not found beside it; give them with --images"
    )


def _find_mesh(source: Path, model: Path) -> Path | None:
    folders = _around(source, model)
    folders += [source / "dense", source / "dense" / model.name]
    candidates = (folder / name for folder in folders for name in MESH_NAMES)
    return next((path for path in candidates if path.is_file()), None)


def _unregistered(folder: Path, names: list[str]) -> tuple[str, ...]:
    """Photographs that lie among the registered ones but that the model does not name."""
    known = set(names)
    beside = {(folder / name).parent for name in names}
    files = (
        path
        for place in beside
        if place.is_dir()
        for path in place.iterdir()
        if path.suffix.lower() in SUFFIXES
    )
    return tuple(sorted(name for path in files if (name := path.relative_to(folder).as_posix()) not in known))


def _photo(path: Path, image: pycolmap.Image) -> Photo:
    lens = _lens_of_file(path, image)
    pose = image.cam_from_world().matrix()
    pinhole = lens.model_name in ("PINHOLE", "SIMPLE_PINHOLE")
    straight = lens if pinhole else undistorted_camera(lens)
    camera = Camera(
        K=np.asarray(straight.calibration_matrix(), dtype=np.float64),
        R=np.ascontiguousarray(pose[:, :3]),
        t=np.ascontiguousarray(pose[:, 3]),
        width=straight.width,
        height=straight.height,
    )
    return Photo(image.name, path, camera, None if pinhole else lens)


def _lens_of_file(path: Path, image: pycolmap.Image) -> pycolmap.Camera:
    """The lens in pixels of the file, which may be a reduced copy of the model's image."""
    assert image.camera is not None  # every image of a model has one
    lens = pycolmap.Camera(image.camera.todict())
    if lens.model_name == "EQUIRECTANGULAR":
        raise NmbgError(f"{path}: a panorama has no pinhole camera; cut it into perspective views first")
    width, height = image_size(path)
    # A reduced copy rounds its sides, so its shape may differ by a pixel.
    if abs(width * lens.height - height * lens.width) > max(lens.width, lens.height):
        raise NmbgError(
            f"{path}: {width}×{height} pixels, but its camera has {lens.width}×{lens.height}; "
            "give the images that the model was made from with --images"
        )
    if (width, height) == (lens.width, lens.height):
        return lens
    lens = _with_two_focal_lengths(lens)
    lens.rescale(width, height)
    return lens


def _with_two_focal_lengths(lens: pycolmap.Camera) -> pycolmap.Camera:
    """The same lens as a model with fx and fy, where there is one: rounded sides scale them differently."""
    f, cx, cy = lens.params[:3]
    general = {
        "SIMPLE_PINHOLE": ("PINHOLE", 0),
        "SIMPLE_RADIAL": ("OPENCV", 4),
        "RADIAL": ("OPENCV", 4),
        "SIMPLE_RADIAL_FISHEYE": ("OPENCV_FISHEYE", 4),
        "RADIAL_FISHEYE": ("OPENCV_FISHEYE", 4),
    }
    if lens.model_name not in general:
        return lens
    model, n_distortion = general[lens.model_name]
    distortion = [*lens.params[3:], 0.0, 0.0, 0.0, 0.0][:n_distortion]
    return pycolmap.Camera(
        model=model, width=lens.width, height=lens.height, params=[f, f, cx, cy, *distortion]
    )
