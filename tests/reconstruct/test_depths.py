from __future__ import annotations

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st

from nmbg.reconstruct.depths import fill_depth, unproject
from nmbg.scene import Scene


def test_filled_depth_favours_the_far_side() -> None:
    depth = torch.ones(32, 32)
    depth[:, 16:] = 3
    known = torch.ones(32, 32, dtype=torch.bool)
    known[8:24, 12:20] = False
    filled = fill_depth(depth, known)
    assert torch.equal(filled[known], depth[known].double())
    assert filled[~known].mean() > 2
    assert filled.max() <= 3 + 1e-9


@given(height=st.integers(1, 33), width=st.integers(1, 33), seed=st.integers(0, 1000), share=st.floats(0, 1))
def test_filled_depth_stays_within_the_known_range(height: int, width: int, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    depth = torch.from_numpy(rng.uniform(0.5, 20, (height, width)))
    known = torch.from_numpy(rng.random((height, width)) < share)
    known[0, 0] = True
    filled = fill_depth(depth, known)
    assert torch.isfinite(filled).all()
    assert filled.min() >= depth[known].min() * (1 - 1e-6)
    assert filled.max() <= depth[known].max() * (1 + 1e-6)


def test_unprojected_depth_projects_back(scene_folder) -> None:
    scene = Scene.load(scene_folder)
    camera = scene.views[3].camera
    depth = torch.rand(camera.height, camera.width, dtype=torch.float64) + 1
    h = camera.project(torch.from_numpy(unproject(camera, depth)).reshape(-1, 3)).reshape(*depth.shape, 3)
    assert torch.allclose(h[..., 2], depth)
    v, u = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    assert torch.allclose(h[..., 0] / depth, u.double() + 0.5, atol=1e-9)
    assert torch.allclose(h[..., 1] / depth, v.double() + 0.5, atol=1e-9)
