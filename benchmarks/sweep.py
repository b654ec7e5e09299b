"""Training runs that are judged and kept: a sweep goes on where it stopped, and measures nothing twice."""

from __future__ import annotations

import hashlib
import json
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
from record import provenance

from nmbg.atomic import atomic_file
from nmbg.evaluation.evaluate import evaluate
from nmbg.scene import Scene
from nmbg.training.checkpoint import latest_checkpoint, load_progress
from nmbg.training.config import PRESETS, VGG_TO_RELU3, TrainConfig
from nmbg.training.trainer import train

METRICS = ("psnr", "ssim", "ssim_svs", "lpips")


@dataclass(frozen=True)
class Job:
    """One run.

    Args:
        scene: scene folder.
        config: how it is trained.
        init: run whose network it begins with, or None.
    """

    scene: Path
    config: TrainConfig
    init: Path | None = None

    @property
    def key(self) -> str:
        """What it is kept under: scene, preset, and a hash of everything that decides it."""
        settings = json.dumps([self.scene.name, asdict(self.config), str(self.init)], sort_keys=True)
        digest = hashlib.sha256(settings.encode()).hexdigest()[:12]
        return f"{self.scene.name}-{self.config.preset}-{digest}"


class Sweep:
    """A folder of finished runs' figures.

    Args:
        output: the folder; figures go into runs/KEY.json, run folders into work/.
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
        missing = [job for job in jobs if not self._path(job).exists()]
        minutes = sum(job.config.minutes or 0 for job in missing)
        click.echo(f"{len(jobs) - len(missing)} of {len(jobs)} runs are there; training: {minutes:g} minutes")
        for job in missing:
            click.echo(job.key)
            self._run(job, split)
        return [json.loads(self._path(job).read_text()) for job in jobs]

    def folder(self, job: Job) -> Path:
        """Run folder of a job."""
        return self.output / "work" / job.key

    def _path(self, job: Job) -> Path:
        return self.output / "runs" / f"{job.key}.json"

    def _run(self, job: Job, split: bool) -> None:
        run = self.folder(job)
        run.parent.mkdir(parents=True, exist_ok=True)
        train(Scene.load(job.scene), job.config, run, self.weights, overwrite=True, init=job.init)
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
            figures["train_psnr"] = evaluate(run, ["psnr"], split="train").mean["psnr"]
        record = {"scene": job.scene.name, "config": asdict(job.config), **provenance(), "figures": figures}
        self._path(job).parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(self._path(job)) as path:
            path.write_text(json.dumps(record, indent=1))


def trained_for(preset: str, minutes: float, seed: int = 0, **changes: Any) -> TrainConfig:
    """A preset with a budget in minutes; L_rec, where there is one, up to relu3_1, so that rungs compare."""
    config = PRESETS[preset]
    perceptual = "none" if config.perceptual == "none" else VGG_TO_RELU3
    budget = minutes if config.stages else None
    return replace(
        config, minutes=budget, epochs=None, iterations=None, perceptual=perceptual, seed=seed, **changes
    )


def spread(records: Sequence[dict[str, Any]], name: str, digits: int) -> str:
    """Mean of a figure, and half of the range of several seeds."""
    values = [record["figures"][name] for record in records]
    mean = f"{statistics.fmean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {(max(values) - min(values)) / 2:.{digits}f}"
