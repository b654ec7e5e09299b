from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from nmbg.scene import Scene
from nmbg.training import checkpoint, loop
from nmbg.training.config import PRESETS, Stage
from nmbg.training.member import split_training
from nmbg.training.trainer import train


def test_statistics_are_those_of_all_views(scene_folder: Path, tmp_path: Path) -> None:
    # Of the network as it is written.
    config = replace(PRESETS["npbg-mesh"], perceptual="none", iterations=6, settle=1.0)
    run = checkpoint.load_run(train(Scene.load(scene_folder), config, tmp_path / "run"))
    network = run.renderer.network
    assert network is not None
    norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
    kept = [(norm.running_mean.clone(), norm.running_var.clone()) for norm in norms]
    seen: list[list[tuple[Tensor, Tensor]]] = [[] for _ in norms]
    for norm, observed in zip(norms, seen, strict=True):

        def note(
            module: nn.Module, inputs: tuple[Tensor], into: list[tuple[Tensor, Tensor]] = observed
        ) -> None:
            var, mean = torch.var_mean(inputs[0], dim=(0, 2, 3))
            into.append((mean, var))

        norm.register_forward_pre_hook(note)
    run.renderer.train()
    views, _ = split_training(Scene.load(scene_folder), config)
    with torch.no_grad():
        for view in views:
            run.renderer(run.renderer.rasterize(view.camera), view.camera)
    for (mean, var), observed in zip(kept, seen, strict=True):
        torch.testing.assert_close(mean, torch.stack([m for m, _ in observed]).mean(0), atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(var, torch.stack([v for _, v in observed]).mean(0), atol=1e-5, rtol=1e-4)


def test_the_network_learns_with_the_statistics_that_it_is_shown_with(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settled: list[tuple[int, dict[str, Tensor]]] = []
    settle = loop.Loop._settle

    def note(self: loop.Loop, stage: Stage) -> None:
        settle(self, stage)
        assert self.crew.network is not None
        state = {name: tensor.clone() for name, tensor in self.crew.network.state_dict().items()}
        settled.append((self.step, state))

    monkeypatch.setattr(loop.Loop, "_settle", note)
    config = replace(PRESETS["npbg"], perceptual="none", iterations=10)
    run = checkpoint.load_run(train(Scene.load(scene_folder), config, tmp_path / "run"))
    assert [step for step, _ in settled] == [4]
    network = run.renderer.network
    assert network is not None
    statistics = {name for name, _ in network.named_buffers()}
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, settled[0][1][name]) is (name in statistics), name
