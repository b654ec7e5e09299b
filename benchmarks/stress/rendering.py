"""Cameras that no photograph was taken from: what a renderer shows, beside what a photograph shows of it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from path import differences
from scipy.spatial.transform import Rotation
from torch import Tensor
from warp import psnr, warped

from nmbg.atomic import atomic_file
from nmbg.cameras import Camera
from nmbg.images import from_bytes, resize, to_bytes, write_image
from nmbg.model.renderer import Renderer
from nmbg.paths import through
from nmbg.progress import progress_bar
from nmbg.scene import Scene, View, evenly
from nmbg.sight import look
from stress.scenes import file_name

# Held-out views that are looked at, and the share of one that must be seen again for a number.
JUDGES, LEAST_SEEN = 3, 0.02
SIDES = (1, 64)  # of random cameras, pixels
FRAMES, PATH_VIEWS = 60, 4

Kept = TypeVar("Kept")
# A run's renderer, loaded where something is rendered: what is kept needs none.
LoadedLate = Callable[[], Renderer]


@dataclass(frozen=True)
class Place:
    """A held-out view: its camera, the median depth of what it sees, and the scene's radius."""

    camera: Camera
    depth: float
    radius: float


@dataclass(frozen=True)
class Rendering:
    """One way for a camera to be unlikely.

    Args:
        name: in tables.
        unit: what severities mean.
        severities: the first is the photograph's own camera.
        change: place, severity → camera, and its pixels a pixel of the photograph.
    """

    name: str
    unit: str
    severities: tuple[float, ...]
    change: Callable[[Place, float], tuple[Camera, float]]


def zoomed(place: Place, severity: float) -> tuple[Camera, float]:
    """A focal length that is so many times as long."""
    zoom = np.diag([severity, severity, 1])
    middle = np.array([[1, 0, place.camera.width / 2], [0, 1, place.camera.height / 2], [0, 0, 1]])
    return replace(place.camera, K=middle @ zoom @ np.linalg.inv(middle) @ place.camera.K), severity


def zoomed_out(place: Place, severity: float) -> tuple[Camera, float]:
    """A focal length that is so many times as short."""
    return zoomed(place, 1 / severity)


def sized(place: Place, severity: float) -> tuple[Camera, float]:
    """Sides that are so many times as long."""
    camera = place.camera
    return camera.resized(round(severity * camera.width), round(severity * camera.height)), severity


def smaller(place: Place, severity: float) -> tuple[Camera, float]:
    """Sides that are so many times as short."""
    return sized(place, 1 / severity)


def wider(place: Place, severity: float) -> tuple[Camera, float]:
    """Wider and lower by this factor, about the middle."""
    camera = place.camera
    width, height = round(camera.width * severity), round(camera.height / severity)
    return camera.cropped((camera.width - width) / 2, (camera.height - height) / 2, width, height), 1.0


def rolled(place: Place, severity: float) -> tuple[Camera, float]:
    """Turned about the optical axis by so many degrees."""
    roll = Rotation.from_euler("z", severity, degrees=True).as_matrix()
    return replace(place.camera, R=roll @ place.camera.R, t=roll @ place.camera.t), 1.0


def nearer(place: Place, severity: float) -> tuple[Camera, float]:
    """Moved along the optical axis by a share of the median depth: from 1 on, into the geometry."""
    camera = replace(place.camera, t=place.camera.t - [0, 0, severity * place.depth])
    return camera, 1 / max(1 - severity, 0.1)


def farther(place: Place, severity: float) -> tuple[Camera, float]:
    """Moved back by so many radii of the foreground sphere."""
    step = severity * place.radius
    camera = replace(place.camera, t=place.camera.t - [0, 0, -step])
    return camera, place.depth / (place.depth + step)


RENDERINGS = (
    Rendering("zoom in", "focal length times", (1, 1.5, 2, 4), zoomed),
    Rendering("zoom out", "focal length divided by", (1, 1.5, 2, 4), zoomed_out),
    Rendering("more pixels", "sides times", (1, 1.5, 2, 3), sized),
    Rendering("fewer pixels", "sides divided by", (1, 1.5, 2, 4), smaller),
    Rendering("aspect", "width times, height divided by", (1, 1.3, 2, 4), wider),
    Rendering("roll", "degrees", (0, 10, 45, 90, 180), rolled),
    Rendering("nearer", "share of the median depth", (0, 0.25, 0.5, 0.75, 1.1), nearer),
    Rendering("farther", "radii of the sphere", (0, 0.25, 0.5, 1, 2, 4), farther),
)


def measure(
    renderer: LoadedLate, scene: Scene, rendering: Rendering, folder: Path, finished: bool
) -> list[dict[str, Any]]:
    """PSNR of what held-out views show and the stressed cameras see, too; whether all is finite.

    "loss" is beside the PSNR of the same pixels as the photographs' own cameras show them, dB.
    """
    name = file_name(rendering.name)

    def picture(severity: float) -> str:
        return f"{name}-{severity:g}.png"

    def compute() -> list[dict[str, Any]]:
        return [
            _measured(renderer(), scene, rendering, severity, folder / picture(severity))
            for severity in rendering.severities
        ]

    points = _kept(folder / f"{name}.json", compute, finished) or []
    return [
        {**point, "picture": str(Path("rendered") / folder.name / picture(point["severity"]))}
        for point in points
    ]


def _measured(
    renderer: Renderer, scene: Scene, rendering: Rendering, severity: float, picture: Path
) -> dict[str, Any]:
    """A point of `measure`; writes the middle one of its pictures."""
    values, finite = [], True
    views = evenly(scene.test, JUDGES)
    for view in views:
        depth = look(scene.mesh, view.camera).depth
        middle = float(depth[depth > 0].median()) if (depth > 0).any() else scene.radius
        camera, scale = rendering.change(Place(view.camera, middle, scene.radius), severity)
        image = renderer.render(camera, without={view.name})
        finite &= bool(torch.isfinite(image).all())
        values.append(_compare(renderer, image, camera, view, scale, scene))
        if view is views[len(views) // 2]:
            write_image(picture, to_bytes(image.nan_to_num()))
    known = [value for value in values if value is not None]
    psnr, loss = (sum(each) / len(known) for each in zip(*known, strict=True)) if known else (None, None)
    return {"severity": severity, "psnr": psnr, "loss": loss, "finite": finite, "judged": len(known)}


def _compare(
    renderer: Renderer, image: Tensor, camera: Camera, view: View, scale: float, scene: Scene
) -> tuple[float, float] | None:
    """PSNR over what the photograph shows as well, at the resolution of the coarser; what it loses."""
    of, photograph = view.camera, scene.load_image(view)
    own = to_bytes(renderer.render(of, without={view.name}))
    if scale > 1:
        small = camera.resized(max(1, round(camera.width / scale)), max(1, round(camera.height / scale)))
        image, camera = from_bytes(resize(to_bytes(image), small.width, small.height)), small
    elif scale < 1:
        of = of.resized(max(1, round(of.width * scale)), max(1, round(of.height * scale)))
        photograph, own = (resize(x, of.width, of.height) for x in (photograph, own))
    shown, seen = warped(image, camera, look(scene.mesh, camera).depth, of, look(scene.mesh, of).depth)
    if seen.float().mean() < LEAST_SEEN:
        return None
    value = psnr(shown, from_bytes(photograph), seen)
    beside = psnr(from_bytes(own), from_bytes(photograph), seen)
    assert value is not None
    assert beside is not None
    return value, beside - value


def away(renderer: LoadedLate, scene: Scene, folder: Path, finished: bool) -> dict[str, Any] | None:
    """A camera far away that looks away, of several sizes: the most that pixels differ within a channel."""

    def compute() -> dict[str, Any]:
        ranges, finite = {}, True
        camera = scene.test[0].camera
        for width, height in ((64, 48), (camera.width, camera.height), (1, 1), (33, 7)):
            place = scene.centre + 1e3 * scene.radius * np.array([0.3, 0.5, 0.8])
            away = camera.resized(width, height).looking_at(2 * place - scene.centre, place, scene.up)
            image = renderer().render(away)
            finite &= bool(torch.isfinite(image).all())
            flat = image.flatten(1)
            ranges[f"{width}×{height}"] = float((flat.amax(1) - flat.amin(1)).max())
        return {"ranges": ranges, "finite": finite}

    return _kept(folder / "away.json", compute, finished)


def random_camera(scene: Scene, random: np.random.Generator) -> Camera:
    """A camera anywhere, looking anywhere, of any size and focal length."""
    width, height = random.integers(SIDES[0], SIDES[1] + 1, 2)
    focal = max(width, height) * 2 ** random.uniform(-3, 4)
    K = np.array([[focal, 0, random.uniform(0, width)], [0, focal, random.uniform(0, height)], [0, 0, 1.0]])
    R = Rotation.random(random_state=random).as_matrix()
    distance = scene.radius * 10 ** random.uniform(-2, 3)
    centre = scene.centre + distance * random.standard_normal(3) / math.sqrt(3)
    if random.random() < 0.2 and len(scene.mesh.vertices):
        centre = scene.mesh.vertices[random.integers(len(scene.mesh.vertices))].astype(np.float64)
    return Camera(K, R, -R @ centre, int(width), int(height))


def soak(
    renderer: LoadedLate, scene: Scene, cameras: int, folder: Path, finished: bool
) -> dict[str, int] | None:
    """Renders of random cameras that are not finite, or not in [0, 1], or of the wrong shape."""

    def compute() -> dict[str, int]:
        bad = 0
        with progress_bar() as bar:
            for i in bar.track(range(cameras), description="random cameras"):
                camera = random_camera(scene, np.random.default_rng(i))
                image = renderer().render(camera)
                right = image.shape == (3, camera.height, camera.width)
                bad += not (right and bool(((image >= 0) & (image <= 1)).all()))
        return {"cameras": cameras, "bad": bad}

    return _kept(folder / f"soak-{cameras}.json", compute, finished)


def flicker(renderer: LoadedLate, scene: Scene, folder: Path, finished: bool) -> dict[str, Any] | None:
    """PSNR of the frames of a smooth path and the ones before them, warped: mean and least, dB."""

    def compute() -> dict[str, Any]:
        path = through([view.camera for view in scene.train[:PATH_VIEWS]], FRAMES)
        depths = [look(scene.mesh, camera).depth for camera in path]
        steps = differences([renderer().render(camera) for camera in path], path, depths)
        values = [step.psnr for step in steps if step.psnr is not None]
        return {"mean": float(np.mean(values)), "least": float(np.min(values))}

    return _kept(folder / "flicker.json", compute, finished)


def _kept(path: Path, compute: Callable[[], Kept], finished: bool) -> Kept | None:
    """What a file holds; computed where there is none, unless only what is finished is asked for."""
    if not path.exists():
        if finished:
            return None
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(compute()))
    found: Kept = json.loads(path.read_text())
    return found
