from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from nmbg.scene import Scene
from nmbg.training import checkpoint
from nmbg.training.config import PRESETS
from nmbg.training.member import split_training
from nmbg.training.trainer import train


def test_a_trained_network_has_the_statistics_of_its_views(scene_folder: Path, tmp_path: Path) -> None:
    config = replace(PRESETS["npbg-mesh"], perceptual="none", iterations=6)
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
