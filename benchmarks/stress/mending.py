"""The same damage, mended as users can: holes closed in preprocessing, poses refined, the model sized."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from nmbg.mesh import merge
from nmbg.preprocess import SIGHT_SIZE
from nmbg.reconstruct.background import make_background
from nmbg.reconstruct.coverage import mask_at
from nmbg.reconstruct.gallery import Gallery
from nmbg.scene import Scene
from nmbg.sight import look
from nmbg.training.config import TrainConfig
from stress.cameras import CAMERAS
from stress.geometry import GEOMETRY, parts
from stress.scenes import Random, Stress
from stress.views import VIEWS

# Whose photographs tell where the surface is; the other presets show what geometry they are given.
PRESETS = ("photos", "nmbg")


def closed(scene: Scene) -> Scene:
    """The scene's surface with patches over its holes and a new shell, made from the training views.

    A surface that none of them sees is left as it is: preprocessing would refuse it.
    """
    surface, _ = parts(scene)
    sights = [look(surface, view.camera.within(SIGHT_SIZE)) for view in scene.train]
    if not any(sight.covered.any() for sight in sights):
        return scene
    masks = [
        mask_at(scene.load_mask(view), sight.camera) for view, sight in zip(scene.train, sights, strict=True)
    ]
    gallery = Gallery.hang(sights, map(scene.load_image, scene.train), masks)
    background = make_background("closed", gallery)
    return replace(
        scene,
        mesh=merge(surface, background.whole),
        shell_vertices=len(background.shell.vertices),
        shell_faces=len(background.shell.faces),
    )


def _then_closed(damage: Callable[[Scene, float, Random], Scene]) -> Callable[[Scene, float, Random], Scene]:
    def mended(scene: Scene, severity: float, random: Random) -> Scene:
        return closed(damage(scene, severity, random)) if severity else scene

    return mended


def with_refined_poses(config: TrainConfig, severity: float) -> TrainConfig:
    """Training that moves its cameras first."""
    return replace(config, refine="poses")


def sized(config: TrainConfig, severity: float) -> TrainConfig:
    """No network where left-out views are not better for it, and no harmonics that do not tell."""
    return replace(config, capacity="auto")


def _mended(stress: Stress) -> Stress:
    """A stress with what mends it."""
    mended = replace(stress, group="mending", presets=PRESETS, mends=stress.name)
    if stress in GEOMETRY:
        return replace(mended, name=f"{stress.name}, closed", scene=_then_closed(stress.scene))
    if stress in VIEWS:
        return replace(mended, name=f"{stress.name}, sized", config=sized, presets=("nmbg",))
    return replace(mended, name=f"{stress.name}, refined", config=with_refined_poses)


MENDED = (
    *("fewer views", "block"),
    *("vertices dropped", "regions cut"),
    *("rotation", "position", "focal length", "principal point"),
)
MENDING = tuple(_mended(s) for s in (*VIEWS, *GEOMETRY, *CAMERAS) if s.name in MENDED)
