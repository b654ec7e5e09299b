"""Every instruction set gives the same bits: the kernels are compiled for each, from one source."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from nmbg import _core

# Digest of what rasterizers, shading and blending give for random input, of all sizes that have a path of
# their own.
DIGEST = """
import hashlib
import torch
from nmbg import _core
from nmbg.ops import blend_photos, mip_chain, rasterize_faces_pyramid, rasterize_points_pyramid
from nmbg.ops import scatter_faces, shade_faces, shade_points

g = torch.Generator().manual_seed(0)
found = []
for size in (0.6, 3.0, 30.0):
    centre = torch.rand(3000, 1, 2, generator=g) * torch.tensor([75.0, 45.0])
    uv = centre + size * (torch.rand(3000, 3, 2, generator=g) - 0.5)
    z = torch.rand(3000, 3, 1, generator=g) * 4 - 0.2
    h = torch.cat([uv * z, z], 2).reshape(-1, 3)
    faces = torch.arange(9000, dtype=torch.int32).reshape(-1, 3)
    rays = torch.nn.functional.normalize(torch.randn(40, 70, 3, generator=g), dim=-1)
    hits = rasterize_faces_pyramid(h, faces, 40, 70, 3)
    points = rasterize_points_pyramid(h, size, 40, 70, 3)
    found += [part for level in hits + points for part in level]
    for channels in (3, 8, 11):
        coeffs = torch.randn(9000, 9, channels, generator=g)
        image = shade_faces(hits[0].face, hits[0].bary, faces, rays, coeffs)
        found += [image, shade_points(points[0].point, points[0].dist2, rays, coeffs)]
        found.append(scatter_faces(image, hits[0].face, hits[0].bary, faces, rays, 9000, 9))

# Seven photographs beside the view, of which some are finer, of a surface that is rough.
depth = 2 + 0.1 * torch.rand(40, 70, generator=g)
warps, K, photos, depths = [], [], [], []
for i in range(7):
    h, w, f = 30 + 9 * i, 50 + 15 * i, 40.0 + 12 * i
    warp = [[1 / 50, 0.002 * i, -0.7, 0.1 * i - 0.3], [0, 1 / 50, -0.4, 0.05 * i], [0, 0.001 * i, 1, 0]]
    warps.append(warp)
    K.append([[f, 0, w / 2], [0, f, h / 2], [0, 0, 1]])
    image = torch.rand(h, w, 3, generator=g)
    photos.append(mip_chain(image))
    depths.append(2 + 0.2 * torch.rand(h, w, generator=g))
for chains in (photos, [(255 * chain).byte() for chain in photos]):
    blend = blend_photos(
        depth, torch.tensor(warps), torch.tensor(K), 50.0, chains, depths, keep=3, border=2.0, each=True
    )
    found += blend
assert all(part.abs().sum() > 0 for part in found)
print(_core.simd, hashlib.sha256(b"".join(part.numpy().tobytes() for part in found)).hexdigest())
"""


def digest(simd: str) -> list[str]:
    env = {**os.environ, "NMBG_SIMD": simd}
    done = subprocess.run([sys.executable, "-c", DIGEST], env=env, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.skipif(_core.simd == "portable", reason="this processor has no wider instructions")
def test_every_instruction_set_gives_the_same_bits():
    used, narrow = digest("portable")
    assert used == "portable"
    for simd in ("avx2", "avx512")[: 1 + (_core.simd == "avx512")]:
        assert digest(simd) == [simd, narrow]
