"""Training runs that are judged and kept: a sweep goes on where it stopped, and measures nothing twice."""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
import statistics
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import click
from record import provenance
from stress import Stressed

from nmbg.atomic import atomic_file
from nmbg.evaluation.evaluate import evaluate
from nmbg.scene import Scene
from nmbg.training.checkpoint import Run, latest_checkpoint, load_progress, load_run
from nmbg.training.config import PRESETS, VGG_TO_RELU3, TrainConfig
from nmbg.training.precision import bf16_is_faster
from nmbg.training.run_views import VIEWS
from nmbg.training.trainer import train

METRICS = ("psnr", "ssim", "ssim_svs", "lpips")
TRAINING_VIEWS = 16  # that are judged beside the held-out ones
# Steps of about one minute, reading the scene and fitting it included; of mesh ten passes over the fox.
STEPS = {"mesh": 430, "npbg": 220, "paper": 330, "nmbg": 800}
QUICK = 0.25  # times these, where something is only tried


@dataclass(frozen=True)
class Job:
    """One run.

    Args:
        scene: scene folder.
        config: how it is trained.
        init: run whose network it begins with, or None.
        stressed: how the scene is made worse before, or None.
        bf16: network in bfloat16 or not; None for what is faster, as `nmbg train` chooses. Then it is no part
            of the key: a sweep may go on where another processor chooses otherwise.
    """

    scene: Path
    config: TrainConfig
    init: Path | None = None
    stressed: Stressed | None = None
    bf16: bool | None = None

    @property
    def key(self) -> str:
        """What it is kept under: scene, preset, and a hash of everything that decides it."""
        parts = [self.name, _given(self.config), str(self.init)]
        parts += [] if self.bf16 is None else [self.bf16]
        settings = json.dumps(parts, sort_keys=True)
        digest = hashlib.sha256(settings.encode()).hexdigest()[:12]
        return f"{self.name}-{self.config.preset}-{digest}"

    @property
    def name(self) -> str:
        """The scene's with its size, and what was done to it."""
        name = f"{self.scene.name}-{_size(self.scene)}"
        return name if self.stressed is None else f"{name}-{self.stressed.key}"


@functools.cache
def _size(scene: Path) -> str:
    camera = Scene.load(scene).views[0].camera
    return f"{camera.width}x{camera.height}"


def _given(value: Any) -> Any:
    """Settings without those at their default: an option that is added later changes nothing that is kept."""
    if isinstance(value, tuple):
        return [_given(part) for part in value]
    if not is_dataclass(value):
        return value
    found = {f.name: (getattr(value, f.name), f.default) for f in fields(value)}
    return {name: _given(given) for name, (given, default) in found.items() if given != default}


class Sweep:
    """A folder of finished runs' figures.

    Args:
        output: the folder; figures go into runs/KEY.json, the middle held-out view as it was rendered into
            runs/KEY.png, run folders into work/. Those of stressed scenes are not kept.
        weights: folder of pretrained weights.
        lpips_net: network of LPIPS.
    """

    def __init__(self, output: Path, weights: Path, lpips_net: str = "squeeze") -> None:
        self.output, self.weights, self.lpips_net = output, weights, lpips_net

    def measure(self, jobs: Sequence[Job], split: bool = True) -> list[dict[str, Any]]:
        """Figures of all jobs, in their order; missing ones are trained now.

        Args:
            jobs: the runs.
            split: judge the training views as well.
        """
        missing = [job for job in jobs if self.found(job) is None]
        minutes = sum(job.config.minutes or 0 for job in missing)
        click.echo(f"{len(jobs) - len(missing)} of {len(jobs)} runs are there; training: {minutes:g} minutes")
        for job in missing:
            click.echo(job.key)
            self._run(job, split)
        return [json.loads(self._path(job).read_text()) for job in jobs]

    def found(self, job: Job) -> dict[str, Any] | None:
        """What is kept of a job; None where it has not been run."""
        path = self._path(job)
        return json.loads(path.read_text()) if path.exists() else None

    def picture(self, job: Job) -> Path:
        """The middle held-out view as a finished job rendered it."""
        return self._path(job).with_suffix(".png")

    def folder(self, job: Job) -> Path:
        """Run folder of a job."""
        return self.output / "work" / job.key

    def _path(self, job: Job) -> Path:
        return self.output / "runs" / f"{job.key}.json"

    def _run(self, job: Job, split: bool) -> None:
        run = self.folder(job)
        run.parent.mkdir(parents=True, exist_ok=True)
        config = in_precision(job.config, job.bf16)
        with _scene(job, self.output / "stressed") as scene:
            train(scene, config, run, self.weights, overwrite=True, init=job.init)
            report = evaluate(run, METRICS, lpips_net=self.lpips_net, weights=self.weights)
            found = latest_checkpoint(run)
            assert found is not None
            progress = load_progress(found)
            figures = {
                **report.mean,
                "seconds_per_frame": report.seconds_per_frame,
                "megabytes": report.megabytes,
                "steps": progress.step,
                "seconds": progress.seconds,
                "skipped": progress.skipped,
            }
            if split:
                training = evaluate(run, ["psnr"], split="train", at_most=TRAINING_VIEWS)
                figures["train_psnr"] = training.mean["psnr"]
        record = {
            "scene": job.scene.name,
            "stressed": None if job.stressed is None else job.stressed.key,
            "config": asdict(config),
            **provenance(),
            "figures": figures,
            "views": report.views,
            "left_out": json.loads((run / VIEWS).read_text())["left_out"],
        }
        middle = scene.test[len(scene.test) // 2]
        self._path(job).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(run / "renders" / Path(middle.name).with_suffix(".png"), self.picture(job))
        with atomic_file(self._path(job)) as path:
            path.write_text(json.dumps(record, indent=1))
        if job.stressed is not None:
            shutil.rmtree(run)


@contextmanager
def _scene(job: Job, folder: Path) -> Iterator[Scene]:
    """The scene of a job; one that is stressed lies in a folder until it has been judged."""
    scene = Scene.load(job.scene)
    if job.stressed is None:
        yield scene
        return
    folder = folder / job.key
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    yield job.stressed.write(scene, folder)
    shutil.rmtree(folder)


def trained_for(
    preset: str, minutes: float | None, seed: int = 0, iterations: int | None = None, **changes: Any
) -> TrainConfig:
    """A preset with a budget in minutes or steps.

    L_rec, where there is one, is up to relu3_1, so that rungs compare.
    """
    config = PRESETS[preset]
    perceptual = "none" if config.perceptual == "none" else VGG_TO_RELU3
    if not config.stages:
        minutes = iterations = None
    return replace(
        config,
        minutes=minutes,
        epochs=None,
        iterations=iterations,
        perceptual=perceptual,
        seed=seed,
        **changes,
    )


def untrained(scene: Path, preset: str, folder: Path) -> Run:
    """A preset that has taken no step, to be timed: what it shows is of no matter.

    Args:
        scene: scene folder.
        preset: its name.
        folder: run folder, replaced.
    """
    config = replace(PRESETS[preset], iterations=0, minutes=None, epochs=None, refine="none")
    config = in_precision(replace(config, stages=(), perceptual="none"))
    return load_run(train(Scene.load(scene), config, folder, overwrite=True))


def in_precision(config: TrainConfig, bf16: bool | None = None) -> TrainConfig:
    """A configuration whose network, if it has one, is in bfloat16 or not; by default as is faster here."""
    if not config.model.widths:
        return config
    return replace(config, bf16=bf16_is_faster(config.device) if bf16 is None else bf16)


def trained_in_steps(preset: str, seed: int = 0, times: float = 1.0) -> TrainConfig:
    """A preset with so many times the steps of about a minute, whatever else the machine does."""
    steps = STEPS.get(preset)
    return trained_for(preset, None, seed, iterations=steps and int(times * steps))


def spread(records: Sequence[dict[str, Any]], name: str, digits: int) -> str:
    """Mean of a figure, and half of the range of several seeds."""
    values = [record["figures"][name] for record in records]
    mean = f"{statistics.fmean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {(max(values) - min(values)) / 2:.{digits}f}"
