"""Captures for all tests, generated: a textured ball on a textured square under a plain sky."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
import trimesh
from hypothesis import settings

from nmbg.images import write_image

# A busy machine is no failure.
settings.register_profile("nmbg", deadline=None)
settings.load_profile("nmbg")

N_CAMERAS = 14  # twelve of them are for training: a network wants as many
SIZE = (64, 48)
BALL = np.array([0.0, 0.0, 0.8])
HALF_SIDE = 2.5
# Parameters behind f, cx, cy (or fx, fy, cx, cy) that bend the image by a pixel or so.
DISTORTION = {
    "SIMPLE_PINHOLE": [],
    "PINHOLE": [],
    "SIMPLE_RADIAL": [0.08],
    "RADIAL": [0.08, -0.02],
    "OPENCV": [0.06, -0.02, 0.002, -0.003],
    "FULL_OPENCV": [0.06, -0.02, 0.002, -0.003, 0.01, 0.01, 0.01, 0.0],
    "FOV": [0.4],
    "SIMPLE_RADIAL_FISHEYE": [0.03],
    "RADIAL_FISHEYE": [0.03, 0.01],
    "OPENCV_FISHEYE": [0.03, 0.01, 0.002, 0.001],
    "THIN_PRISM_FISHEYE": [0.03, 0.01, 0.001, 0.001, 0.0, 0.0, 0.001, 0.001],
}
ONE_FOCAL_LENGTH = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}


def lens(model: str, camera_id: int = 1) -> pycolmap.Camera:
    """A COLMAP camera of any model with distinct, off-centre parameters."""
    width, height = SIZE
    focal = [60.0] if model in ONE_FOCAL_LENGTH else [60.0, 61.0]
    params = [*focal, width / 2 + 0.7, height / 2 - 0.4, *DISTORTION[model]]
    return pycolmap.Camera(model=model, width=width, height=height, params=params, camera_id=camera_id)


def poses(n_cameras: int) -> list[pycolmap.Rigid3d]:
    """World → camera, on a ring that looks at the ball from somewhat above; z is up."""
    out = []
    for angle in np.arange(n_cameras) * 2 * np.pi / n_cameras:
        centre = np.array([3.2 * np.cos(angle), 3.2 * np.sin(angle), 1.8 + 0.3 * np.sin(3 * angle)])
        forward = BALL - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        out.append(pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre))
    return out


def photograph(camera: pycolmap.Camera, pose: pycolmap.Rigid3d) -> np.ndarray:
    """Trace the world through a lens, [H, W, 3] uint8."""
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    normalised = camera.cam_from_img(np.stack([u.ravel(), v.ravel()], axis=1))
    rotation = pose.rotation.matrix()
    origin = -rotation.T @ pose.translation
    d = np.concatenate([normalised, np.ones((len(normalised), 1))], axis=1) @ rotation
    d /= np.linalg.norm(d, axis=1, keepdims=True)

    to_ball = origin - BALL
    b, c = d @ to_ball, to_ball @ to_ball - 0.8**2
    with np.errstate(invalid="ignore", divide="ignore"):
        ball = np.where(b**2 > c, -b - np.sqrt(b**2 - c), np.inf)
        ground = np.where(d[:, 2] < 0, -origin[2] / d[:, 2], np.inf)
    at_ground = origin + d * np.where(np.isfinite(ground), ground, 0)[:, None]
    ground[np.abs(at_ground[:, :2]).max(1) > HALF_SIDE] = np.inf
    nearest = np.minimum(ball, ground)
    hit = np.isfinite(nearest)
    colour = 0.5 + 0.3 * d[:, [2, 2, 2]] + [0.0, 0.05, 0.2]
    colour[hit] = texture((origin + d * np.where(hit, nearest, 0)[:, None])[hit])
    return (colour.clip(0, 1) * 255).round().astype(np.uint8).reshape(camera.height, camera.width, 3)


def texture(points: np.ndarray) -> np.ndarray:
    """Colour of the surface at [N, 3] points, [N, 3] in [0, 1]."""
    x, y, z = points.T
    return 0.5 + 0.4 * np.stack([np.sin(3 * x), np.sin(3 * y + 1), np.sin(3 * z + 2 * x)], axis=1)


def surface() -> trimesh.Trimesh:
    """The ball and the square as one mesh without colours."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.8)
    ball.apply_translation(BALL)
    n = 13
    x, y = np.meshgrid(np.linspace(-HALF_SIDE, HALF_SIDE, n), np.linspace(-HALF_SIDE, HALF_SIDE, n))
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + n], 1), np.stack([corner + 1, corner + n + 1, corner + n], 1)]
    )
    square = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1), faces, process=False)
    whole = trimesh.util.concatenate([ball, square])
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def write_workspace(
    folder: Path,
    model: str = "PINHOLE",
    camera: pycolmap.Camera | None = None,
    n_points: int = 60,
    n_cameras: int = N_CAMERAS,
) -> Path:
    """A COLMAP workspace with images/, sparse/0 (binary) and meshed-delaunay.ply, seen through one lens.

    The points' observations are off by about half a pixel, as real ones are.
    """
    rng = np.random.default_rng(0)
    camera = camera or lens(model)
    surface_mesh = surface()
    points = surface_mesh.vertices[rng.choice(len(surface_mesh.vertices), n_points, replace=False)]
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(camera)
    tracks = [pycolmap.Track() for _ in points]
    (folder / "images").mkdir(parents=True)
    for i, pose in enumerate(poses(n_cameras)):
        in_camera = points @ pose.rotation.matrix().T + pose.translation
        pixels = np.asarray(camera.img_from_cam(in_camera)) + rng.normal(0, 0.5, (n_points, 2))
        seen = np.flatnonzero(((pixels > 0) & (pixels < (camera.width, camera.height))).all(1))
        name = f"{i:03d}.png"
        image = pycolmap.Image(name=name, keypoints=pixels[seen], camera_id=1, image_id=i + 1)
        reconstruction.add_image_with_trivial_frame(image, pose)
        for k, j in enumerate(seen):
            tracks[j].add_element(i + 1, k)
        write_image(folder / "images" / name, photograph(camera, pose))
    for point, track in zip(points, tracks, strict=True):
        reconstruction.add_point3D(point, track)
    reconstruction.update_point_3d_errors()
    (folder / "sparse" / "0").mkdir(parents=True)
    reconstruction.write_binary(folder / "sparse" / "0")
    surface_mesh.export(folder / "meshed-delaunay.ply")
    return folder


@pytest.fixture(scope="session")
def make_workspace() -> Callable[..., Path]:
    """`make_workspace(folder, model="PINHOLE")` writes a workspace of photographs through any lens."""
    return write_workspace


@pytest.fixture(scope="session")
def shared_workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pinhole workspace, for reading only."""
    return write_workspace(tmp_path_factory.mktemp("capture") / "workspace")


@pytest.fixture
def workspace(shared_workspace: Path, tmp_path: Path) -> Path:
    """A copy of the pinhole workspace that a test may damage."""
    return Path(shutil.copytree(shared_workspace, tmp_path / "workspace"))


@pytest.fixture(scope="session")
def scene_folder(shared_workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The workspace preprocessed with default options, for reading only."""
    from nmbg.preprocess import preprocess  # needs the compiled operations, which few tests do

    folder = tmp_path_factory.mktemp("scenes") / "scene"
    preprocess(shared_workspace, folder)
    return folder


@pytest.fixture(scope="session")
def scene_of_nine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same seen by nine cameras, seven of them for training, for reading only."""
    from nmbg.preprocess import preprocess

    folder = tmp_path_factory.mktemp("nine")
    preprocess(write_workspace(folder / "workspace", n_cameras=9), folder / "scene")
    return folder / "scene"


@pytest.fixture(scope="session")
def captures() -> Path:
    """The folder of real captures; skips where they are not at hand."""
    folder = Path(__file__).parents[2] / "shared" / "scenes"
    if not folder.is_dir():
        pytest.skip(f"no real captures at {folder}")
    return folder
