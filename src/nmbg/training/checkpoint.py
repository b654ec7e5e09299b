"""Run folders: config.yaml beside checkpoints/STEP, complete or absent; nothing pickled is ever executed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from nmbg import __version__
from nmbg.atomic import atomic_file, atomic_folder
from nmbg.capacity.choices import Choice
from nmbg.capacity.packing import unpack
from nmbg.capacity.storage import Storage, store
from nmbg.errors import NmbgError
from nmbg.mesh import Mesh, split_layers
from nmbg.model.config import ModelConfig
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene, View
from nmbg.training.config import Stage, TrainConfig
from nmbg.training.precision import bf16_is_faster
from nmbg.training.run_views import load_exposures

CONFIG = "config.yaml"
SCENE = "scene"
SCENES = "scenes"
OPTIMISERS = "optimisers.pt"


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
        length: steps of a pass over the training views.
        seconds: seconds spent.
        stage: index of the stage whose optimisers' state is kept.
        caution: factor of the learning rates, below 1 after losses that were not finite.
        skipped: per view, how many steps were left out because its loss was not finite.
        scenes: of a run over several scenes, the step of each one's own checkpoint.
    """

    step: int = 0
    length: int = 0
    seconds: float = 0.0
    stage: int = 0
    caution: float = 1.0
    skipped: dict[str, int] = field(default_factory=dict)
    scenes: dict[str, int] = field(default_factory=dict)


def scene_layers(scene: Scene, config: ModelConfig) -> list[Mesh]:
    """The scene's geometry as the model's layers, foreground first."""
    if config.layers == 1:
        return [scene.mesh]
    return list(split_layers(scene.mesh, scene.centre, scene.radius))


def build_renderer(scene: Scene, config: TrainConfig, network: nn.Module | None = None) -> Renderer:
    """A renderer with zero descriptors and the network given, or one with seeded weights."""
    torch.manual_seed(config.seed)
    return Renderer(config.model, scene_layers(scene, config.model), network).to(config.device)


def remember_photographs(run: Path, renderer: Renderer, cache_gib: float = TrainConfig.cache_gib) -> None:
    """Let a renderer blend the photographs that the run holds, when its model blends any."""
    if renderer.config.sources:
        scene = Scene.load(run / SCENE)
        renderer.remember(scene, scene.views, cache_gib)


def save_config(folder: Path, run: Path, scenes: Mapping[str, Path], config: TrainConfig) -> None:
    """Write config.yaml; scenes are stored relative to the run, so that both can be moved together.

    Args:
        folder: where to write it.
        run: the place that `folder` will have.
        scenes: name → scene folder.
        config: how they are trained.
    """
    home = run.resolve()
    content = {
        "nmbg": __version__,
        "scenes": {name: os.path.relpath(scene.resolve(), home) for name, scene in scenes.items()},
        **asdict(config),
    }
    with atomic_file(folder / CONFIG) as path:
        path.write_text(yaml.safe_dump(_plain(content), sort_keys=False))


def save_scene(run: Path, scene: Scene, views: Sequence[View], storage: Storage) -> None:
    """Write what rendering needs of a scene into the run: its geometry and these photographs."""
    folder = run / SCENE
    replace(scene, views=store(scene, views, folder, storage)).save(folder)


def load_config(run: Path) -> tuple[dict[str, Path], TrainConfig]:
    """Read config.yaml → name → scene folder, and how they are trained.

    Raises:
        NmbgError: no run folder, or its config.yaml is damaged or of another version.
    """
    path = run / CONFIG
    if not path.is_file():
        raise NmbgError(f"{run}: not a run folder (no {CONFIG}); give the --output folder of nmbg train")
    try:
        content = yaml.safe_load(path.read_text())
        home, scenes = run.resolve(), content.pop("scenes")
        folders = {name: Path(os.path.normpath(home / scene)) for name, scene in scenes.items()}
        content.pop("nmbg")
        content["model"]["widths"] = tuple(content["model"]["widths"])
        content["zoom"] = tuple(content["zoom"])
        content["model"] = ModelConfig(**content["model"])
        content["stages"] = tuple(Stage(**stage) for stage in content["stages"])
        content["choices"] = tuple(Choice(**choice) for choice in content["choices"])
        return folders, TrainConfig(**content)
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
        reason = str(error).splitlines()[0]
        raise NmbgError(f"{path}: damaged or of another version ({reason}); train the run anew") from error


def load_one(run: Path) -> tuple[Path, TrainConfig]:
    """Read the config.yaml of a run of one scene → its folder, and how it is trained.

    Raises:
        NmbgError: as load_config(); or the run holds several scenes.
    """
    scenes, config = load_config(run)
    if len(scenes) != 1:
        raise NmbgError(f"{run}: holds {len(scenes)} scenes; name one of them: {run / SCENES / min(scenes)}")
    return next(iter(scenes.values())), config


def save_checkpoint(
    run: Path,
    progress: Progress,
    modules: Mapping[str, nn.Module | None],
    optimisers: Mapping[str, Any] | None = None,
) -> Path:
    """Write checkpoints/STEP: NAME.safetensors of each module, the optimisers' states, and progress.json."""
    folder = run / "checkpoints" / f"{progress.step:08d}"
    with atomic_folder(folder, overwrite=True) as temporary:
        for name, module in modules.items():
            if module is not None:
                save_module(temporary, name, module)
        torch.save(dict(optimisers or {}), temporary / OPTIMISERS)
        (temporary / "progress.json").write_text(json.dumps(asdict(progress)))
    return folder


def save_module(checkpoint: Path, name: str, module: nn.Module) -> None:
    """Replace one module's weights in a checkpoint."""
    tensors = {key: tensor.detach().cpu().contiguous() for key, tensor in module.state_dict().items()}
    with atomic_file(checkpoint / f"{name}.safetensors") as path:
        save_file(tensors, path)


def drop_others(checkpoint: Path) -> None:
    """Drop the checkpoints beside one."""
    for other in checkpoint.parent.iterdir():
        if other.name != checkpoint.name:
            shutil.rmtree(other, ignore_errors=True)


def latest_checkpoint(run: Path) -> Path | None:
    """The newest checkpoint's folder, or None."""
    found = sorted((run / "checkpoints").glob("[0-9]*"))
    return found[-1] if found else None


def load_module(checkpoint: Path, name: str, module: nn.Module | None) -> None:
    """Load a module's weights from a checkpoint; a module that is None has none.

    Raises:
        NmbgError: the file is missing, damaged, or belongs to another model or scene.
    """
    if module is None:
        return
    path = checkpoint / f"{name}.safetensors"
    try:
        module.load_state_dict(unpack(load_file(path)))
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
        NmbgError: the file is missing or damaged.
    """
    try:
        state: dict[str, Any] = json.loads((checkpoint / "progress.json").read_text())
        return Progress(**{f.name: state[f.name] for f in fields(Progress)})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise NmbgError(
            f"{checkpoint}: damaged checkpoint ({_first_line(error)}); train the run anew"
        ) from error


def load_optimisers(checkpoint: Path) -> dict[str, Any]:
    """Load the optimisers' states.

    Raises:
        NmbgError: the file is missing or damaged.
    """
    try:
        state = torch.load(checkpoint / OPTIMISERS, weights_only=True, map_location="cpu")
        return dict(state)
    except Exception as error:  # torch.load raises anything on damaged files
        raise NmbgError(
            f"{checkpoint}: damaged checkpoint ({_first_line(error)}); train the run anew"
        ) from error


def load_run(run: Path, device: str = "cpu") -> Run:
    """Load a run for rendering; its network renders in bfloat16 where that is faster here.

    Args:
        run: a run folder.
        device: where shading and the network run.

    Raises:
        NmbgError: what is missing or damaged, and the remedy.
    """
    folder, config = load_one(run)
    checkpoint = latest_checkpoint(run)
    if checkpoint is None:
        raise NmbgError(f"{run}: no checkpoint yet; continue it with nmbg train --resume")
    renderer = build_renderer(Scene.load(run / SCENE), replace(config, device=device))
    load_module(checkpoint, "descriptors", renderer.descriptors)
    load_module(checkpoint, "network", renderer.network)
    remember_photographs(run, renderer)
    renderer.exposures = load_exposures(run)
    renderer.bf16 = renderer.network is not None and bf16_is_faster(device)
    return Run(run, folder, config, renderer.eval())


def _first_line(error: BaseException) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def _plain(value: Any) -> Any:
    """Tuples as lists: YAML has no tuples."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value
