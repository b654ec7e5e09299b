"""Photographs of the demo scene, as a COLMAP workspace whose mesh is worse than the true surface."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nmbg.atomic import atomic_folder
from nmbg.cameras import Array, Camera
from nmbg.colmap import pycolmap
from nmbg.demo.appearance import SUN, Appearance, encode
from nmbg.demo.shapes import Floats, Ints, Part, build_parts, vertex_normals
from nmbg.images import Image, write_image
from nmbg.mesh import Mesh, save_mesh
from nmbg.ops import rasterize_faces
from nmbg.progress import progress_bar


@dataclass(frozen=True)
class CaptureConfig:
    """How the demo's capture is made.

    Args:
        views: photographs, half of them on each of two rings.
        width: of a photograph, pixels.
        height: of a photograph, pixels.
        samples: samples per pixel along each side.
        true_edge: edge length of the surface that is photographed, scene units.
        mesh_edge: edge length of the mesh that is handed on, scene units.
        noise: standard deviation of that mesh's vertices along their normals, as a share of `mesh_edge`.
        points: COLMAP's 3D points.
        seed: of the textures, the camera shake and the noise.
    """

    views: int = 40
    width: int = 320
    height: int = 240
    samples: int = 3
    true_edge: float = 0.016
    mesh_edge: float = 0.035
    noise: float = 0.06
    points: int = 3000
    seed: int = 0


class Surface:
    """Parts in one mesh, ready to be photographed.

    Args:
        parts: of the scene.
        appearance: of the parts.
    """

    def __init__(self, parts: list[Part], appearance: Appearance) -> None:
        self.appearance = appearance
        self.names = [part.name for part in parts]
        self.centres = torch.from_numpy(np.stack([part.centre for part in parts])).float()
        vertices, faces = joined(parts)
        self.vertices = torch.from_numpy(vertices).float()
        self.faces = torch.from_numpy(faces)
        self.normals = torch.from_numpy(vertex_normals(vertices, faces)).float()
        self._part = torch.repeat_interleave(
            torch.arange(len(parts)), torch.tensor([len(part.faces) for part in parts])
        )
        self._sun = self._sunlit()

    def depth(self, camera: Camera) -> tuple[Tensor, Tensor]:
        """Nearest face [H, W] int32 and its depth [H, W]; −1 and 0 where there is none."""
        h = camera.project(self.vertices)
        face, _, depth = rasterize_faces(h, self.faces, camera.height, camera.width)
        return face, depth

    def photograph(self, camera: Camera, samples: int) -> Image:
        """Render a view, [H, W, 3] uint8 sRGB, averaging samples × samples per pixel in linear light."""
        fine = camera.resized(camera.width * samples, camera.height * samples)
        face, bary, _ = rasterize_faces(fine.project(self.vertices), self.faces, fine.height, fine.width)
        eye = torch.from_numpy(camera.centre).float()
        hit = face.reshape(-1) >= 0
        light = torch.empty(len(hit), 3)
        light[~hit] = self.appearance.landscape(eye, fine.rays().reshape(-1, 3)[~hit])
        light[hit] = self._shade(face.reshape(-1)[hit].long(), bary.reshape(-1, 3)[hit], eye)
        # Film saturates before it is averaged: a highlight does not outshine the pixel it is a part of.
        image = light.clamp(0, 1).reshape(camera.height, samples, camera.width, samples, 3).mean((1, 3))
        return (255 * encode(image)).round().to(torch.uint8).numpy()

    def _shade(self, face: Tensor, bary: Tensor, eye: Tensor) -> Tensor:
        corners = self.faces[face].long()
        position = (bary[..., None] * self.vertices[corners]).sum(1)
        normal = F.normalize((bary[..., None] * self.normals[corners]).sum(1), dim=1)
        sun = (bary * self._sun[corners]).sum(1)
        part = self._part[face]
        light = torch.empty_like(position)
        for i, name in enumerate(self.names):
            here = part == i
            p = position[here]
            light[here] = self.appearance.surface(name, p - self.centres[i], p, normal[here], eye, sun[here])
        return light

    def _sunlit(self) -> Tensor:
        """Share of the sun that reaches each vertex, [N] in [0, 1]: interpolated, it gives soft shadows."""
        camera = looking_at(np.array(SUN), np.zeros(3), 1400, 1600, 1600)
        _, depth = self.depth(camera)
        # Lifted off the surface, so that it casts no shadow on itself.
        u, v, z = camera.project(self.vertices + 0.03 * self.normals).unbind(1)
        grid = torch.stack([2 * u / z / camera.width - 1, 2 * v / z / camera.height - 1], 1)
        lit = torch.zeros_like(z)
        offsets = [(i, j) for i in (-4, 0, 4) for j in (-4, 0, 4)]
        for dx, dy in offsets:
            moved = grid + torch.tensor([2 * dx / camera.width, 2 * dy / camera.height])
            # Not interpolated: between an edge and the void there is no surface.
            nearest = F.grid_sample(depth[None, None], moved[None, None], "nearest", align_corners=False)
            lit += ((nearest == 0) | (z < nearest)).reshape(-1)
        return lit / len(offsets)


def joined(parts: list[Part]) -> tuple[Floats, Ints]:
    """All parts as one mesh: vertices [N, 3], faces [M, 3]."""
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + np.int32(offset) for part, offset in zip(parts, first, strict=False)]
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces)


def looking_at(
    centre: Array, target: Array, focal: float, width: int, height: int, roll: float = 0.0
) -> Camera:
    """A camera at `centre` that looks at `target`, z up, turned by `roll` radians about its axis."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    upright = Camera(K, np.eye(3), np.zeros(3), width, height).looking_at(
        target, centre, np.array([0.0, 0.0, 1.0])
    )
    c, s = math.cos(roll), math.sin(roll)
    R = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ upright.R
    return replace(upright, R=R, t=-R @ centre)


def two_rings(config: CaptureConfig) -> list[Camera]:
    """Hand-held cameras around the terrace, the second ring higher and nearer."""
    rng = np.random.default_rng(config.seed)
    low = (config.views + 1) // 2
    cameras = []
    for i in range(config.views):
        ring, k, n = (0, i, low) if i < low else (1, i - low, config.views - low)
        angle = 2 * np.pi * (k + 0.5 * ring + rng.normal(scale=0.06)) / n
        radius, height = ((3.05, 1.0), (2.4, 2.1))[ring]
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), height]) + rng.normal(
            scale=0.04, size=3
        )
        target = np.array([0.0, 0.0, 0.35]) + rng.normal(scale=0.05, size=3)
        cameras.append(
            looking_at(
                centre, target, 0.95 * config.width, config.width, config.height, rng.normal(scale=0.02)
            )
        )
    return cameras


def noisy_mesh(config: CaptureConfig) -> Mesh:
    """The mesh that is handed on: coarser than the photographed surface, and moved along its normals."""
    rng = np.random.default_rng(config.seed)
    vertices, faces = joined(build_parts(config.mesh_edge))
    shift = config.noise * config.mesh_edge * rng.standard_normal((len(vertices), 1))
    vertices = vertices + shift * vertex_normals(vertices, faces)
    grey = np.full((len(vertices), 3), 128, np.uint8)
    return Mesh(vertices.astype(np.float32), faces, grey)


def make_capture(folder: Path, config: CaptureConfig, overwrite: bool = False) -> None:
    """Write a COLMAP workspace: images/, sparse/0, meshed-delaunay.ply.

    Args:
        folder: the workspace.
        config: how it is made.
        overwrite: replace `folder` if it exists.

    Raises:
        NmbgError: `folder` exists and may not be replaced.
    """
    with atomic_folder(folder, overwrite) as temporary:
        surface = Surface(build_parts(config.true_edge), Appearance(config.seed))
        cameras = two_rings(config)
        (temporary / "images").mkdir()
        with progress_bar() as bar:
            for i, camera in enumerate(bar.track(cameras, description="photographing")):
                write_image(temporary / "images" / _name(i), surface.photograph(camera, config.samples))
        sparse = temporary / "sparse" / "0"
        sparse.mkdir(parents=True)
        _reconstruction(surface, cameras, config).write_binary(str(sparse))
        save_mesh(noisy_mesh(config), temporary / "meshed-delaunay.ply")


def _name(i: int) -> str:
    return f"{i:03d}.png"


def _reconstruction(
    surface: Surface, cameras: list[Camera], config: CaptureConfig
) -> pycolmap.Reconstruction:
    """COLMAP's model: true cameras, and points of the true surface where at least two views see them."""
    rng = np.random.default_rng(config.seed)
    chosen = rng.choice(len(surface.vertices), min(config.points, len(surface.vertices)), replace=False)
    points = surface.vertices[torch.from_numpy(np.sort(chosen))]
    model = pycolmap.Reconstruction()
    tracks: list[list[tuple[int, int]]] = [[] for _ in points]
    for i, camera in enumerate(cameras, start=1):
        model.add_camera_with_trivial_rig(_colmap_camera(camera, i))
        seen, pixels = _observations(surface, camera, points)
        pixels = pixels + rng.normal(scale=0.25, size=pixels.shape)
        image = pycolmap.Image(name=_name(i - 1), keypoints=pixels, camera_id=i, image_id=i)
        pose = pycolmap.Rigid3d(np.concatenate([camera.R, camera.t[:, None]], axis=1))
        model.add_image_with_trivial_frame(image, pose)
        for k, point in enumerate(seen):
            tracks[point].append((i, k))
    for point, track in zip(points.double().numpy(), tracks, strict=True):
        if len(track) >= 2:
            elements = [pycolmap.TrackElement(image, k) for image, k in track]
            model.add_point3D(point, pycolmap.Track(elements), np.full(3, 128, np.uint8))
    model.update_point_3d_errors()
    return model


def _colmap_camera(camera: Camera, number: int) -> pycolmap.Camera:
    K = camera.K
    return pycolmap.Camera(
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        camera_id=number,
    )


def _observations(surface: Surface, camera: Camera, points: Tensor) -> tuple[list[int], Array]:
    """Which points a view sees, and at which pixels [n, 2]."""
    _, depth = surface.depth(camera)
    u, v, z = camera.project(points.double()).unbind(1)
    x, y = u / z, v / z
    inside = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    column = x.clamp(0, camera.width - 1).long()
    row = y.clamp(0, camera.height - 1).long()
    seen = inside & ((depth[row, column] - z).abs() < 0.01 * z)
    return seen.nonzero().ravel().tolist(), torch.stack([x, y], 1)[seen].numpy()
