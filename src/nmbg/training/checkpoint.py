"""Run folders: config.yaml beside checkpoints/STEP, complete or absent; nothing pickled is ever executed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file

from nmbg import __version__
from nmbg.atomic import atomic_file, atomic_folder
from nmbg.errors import NmbgError
from nmbg.mesh import Mesh, split_layers
from nmbg.model.config import ModelConfig
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene, View
from nmbg.training.config import Stage, TrainConfig
from nmbg.training.optimiser import State

CONFIG = "config.yaml"
SCENE = "scene"


@dataclass(frozen=True)
class Run:
    """A run folder, loaded for rendering.

    Args:
        folder: the run.
        source: the scene folder that it was trained on.
        config: how it was trained.
        renderer: the trained model.
    """

    folder: Path
    source: Path
    config: TrainConfig
    renderer: Renderer


@dataclass(frozen=True)
class Progress:
    """Where a run stands.

    Args:
        step: steps done.
        seconds: seconds spent.
        stage: index of the stage whose optimiser state is kept.
        optimiser: its state.
    """

    step: int = 0
    seconds: float = 0.0
    stage: int = 0
    optimiser: list[State] | None = None


def scene_layers(scene: Scene, config: ModelConfig) -> list[Mesh]:
    """The scene's geometry as the model's layers, foreground first."""
    if config.layers == 1:
        return [scene.mesh]
    return list(split_layers(scene.mesh, scene.centre, scene.radius))


def build_renderer(scene: Scene, config: TrainConfig) -> Renderer:
    """A renderer with seeded weights and zero descriptors."""
    torch.manual_seed(config.seed)
    return Renderer(config.model, scene_layers(scene, config.model)).to(config.device)


def remember_photographs(run: Path, renderer: Renderer) -> None:
    """Let a renderer blend the photographs that the run holds, when its model blends any."""
    if renderer.config.sources:
        scene = Scene.load(run / SCENE)
        renderer.remember(scene, scene.views)


def save_config(run: Path, scene: Scene, config: TrainConfig) -> None:
    """Write config.yaml; the scene is stored relative to the run, so that both can be moved together."""
    content = {
        "nmbg": __version__,
        "scene": os.path.relpath(scene.folder.resolve(), run.resolve()),
        **asdict(config),
    }
    with atomic_file(run / CONFIG) as path:
        path.write_text(yaml.safe_dump(_plain(content), sort_keys=False))


def save_scene(run: Path, scene: Scene, views: Sequence[View]) -> None:
    """Write what rendering needs of a scene into the run: its geometry and these photographs."""
    folder = run / SCENE
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    for view in views:
        shutil.copyfile(scene.folder / "images" / view.image, folder / "images" / view.image)
        if view.mask is not None:
            shutil.copyfile(scene.folder / "masks" / view.mask, folder / "masks" / view.mask)
    replace(scene, views=tuple(views)).save(folder)


def load_config(run: Path) -> tuple[Path, TrainConfig]:
    """Read config.yaml → scene folder, config.

    Raises:
        NmbgError: no run folder, or its config.yaml is damaged or of another version.
    """
    path = run / CONFIG
    if not path.is_file():
        raise NmbgError(f"{run}: not a run folder (no {CONFIG}); give the --output folder of nmbg train")
    try:
        content = yaml.safe_load(path.read_text())
        scene = Path(os.path.normpath(run.resolve() / content.pop("scene")))
        content.pop("nmbg")
        content["model"]["widths"] = tuple(content["model"]["widths"])
        content["model"] = ModelConfig(**content["model"])
        content["stages"] = tuple(Stage(**stage) for stage in content["stages"])
        return scene, TrainConfig(**content)
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
        reason = str(error).splitlines()[0]
        raise NmbgError(f"{path}: damaged or of another version ({reason}); train the run anew") from error


def save_checkpoint(run: Path, renderer: Renderer, progress: Progress) -> None:
    """Write checkpoints/STEP, then drop the older ones."""
    folder = run / "checkpoints" / f"{progress.step:08d}"
    with atomic_folder(folder, overwrite=True) as temporary:
        tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in renderer.state_dict().items()}
        save_file(tensors, temporary / "model.safetensors")
        torch.save(progress.optimiser, temporary / "optimiser.pt")
        state = {"step": progress.step, "seconds": progress.seconds, "stage": progress.stage}
        (temporary / "progress.json").write_text(json.dumps(state))
    for other in folder.parent.iterdir():
        if other.name != folder.name:
            shutil.rmtree(other, ignore_errors=True)


def latest_checkpoint(run: Path) -> Path | None:
    """The newest checkpoint's folder, or None."""
    found = sorted((run / "checkpoints").glob("[0-9]*"))
    return found[-1] if found else None


def load_model(checkpoint: Path, renderer: Renderer) -> None:
    """Load a checkpoint's weights.

    Raises:
        NmbgError: the file is missing, damaged, or belongs to another model or scene.
    """
    path = checkpoint / "model.safetensors"
    try:
        renderer.load_state_dict(load_file(path))
    except (SafetensorError, OSError) as error:
        raise NmbgError(
            f"{path}: not a readable checkpoint ({_first_line(error)}); train the run anew"
        ) from error
    except RuntimeError as error:
        raise NmbgError(
            f"{path}: belongs to another model or scene; use the run and scene it came from"
        ) from error


def load_progress(checkpoint: Path) -> Progress:
    """Load where training stood.

    Raises:
        NmbgError: the files are missing or damaged.
    """
    try:
        state: dict[str, Any] = json.loads((checkpoint / "progress.json").read_text())
        optimiser = torch.load(checkpoint / "optimiser.pt", weights_only=True, map_location="cpu")
        return Progress(**{f.name: state[f.name] for f in fields(Progress)[:3]}, optimiser=optimiser)
    except Exception as error:  # torch.load raises anything on damaged files
        raise NmbgError(
            f"{checkpoint}: damaged checkpoint ({_first_line(error)}); train the run anew"
        ) from error


def load_run(run: Path, device: str = "cpu") -> Run:
    """Load a run for rendering.

    Args:
        run: a run folder.
        device: where shading and the network run.

    Raises:
        NmbgError: what is missing or damaged, and the remedy.
    """
    folder, config = load_config(run)
    checkpoint = latest_checkpoint(run)
    if checkpoint is None:
        raise NmbgError(f"{run}: no checkpoint yet; continue it with nmbg train --resume")
    renderer = build_renderer(Scene.load(run / SCENE), replace(config, device=device))
    load_model(checkpoint, renderer)
    remember_photographs(run, renderer)
    return Run(run, folder, config, renderer.eval())


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _plain(value: Any) -> Any:
    """Tuples as lists: YAML has no tuples."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
