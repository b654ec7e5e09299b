"""The ops in plain torch, one expression per rule: the specification of the kernels.

Same names, arguments and results as nmbg.ops. Every item is tested against every pixel, in chunks of bounded
memory; gradients are torch's own.
"""

from __future__ import annotations

import torch
from torch import Tensor

from nmbg.ops.rasterize import face_depth

__all__ = ["face_depth", "harmonics", "rasterize_faces", "rasterize_points", "shade_faces", "shade_points"]

_CHUNK = 1 << 21  # (item, pixel) pairs tested at a time


def _centres(height: int, width: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """Pixel centres: x [1, W] and y [H, 1]."""
    x = torch.arange(width, dtype=like.dtype, device=like.device) + 0.5
    y = torch.arange(height, dtype=like.dtype, device=like.device) + 0.5
    return x[None, :], y[:, None]


def _update(nearest: Tensor, index: Tensor, depth: Tensor, first: int) -> tuple[Tensor, Tensor]:
    """Let the items `first`, `first` + 1, … with `depth` [n, H, W], ∞ where absent, compete for pixels."""
    # argmin takes the first of equal depths, strictly less keeps what is there: ties go to the lower index.
    best = depth.argmin(0)
    z = depth.gather(0, best[None])[0]
    closer = z < nearest
    return torch.where(closer, z, nearest), torch.where(closer, first + best, index)


def rasterize_points(h: Tensor, radius_px: float, height: int, width: int) -> tuple[Tensor, Tensor]:
    """See nmbg.ops.rasterize_points()."""
    x, y = _centres(height, width, h)
    uv = h[:, :2] / h[:, 2:]
    drawn = (h[:, 2] > 0) & h.isfinite().all(1)
    radius2 = torch.tensor(radius_px * radius_px, dtype=h.dtype)

    def squared_distance(uv: Tensor) -> Tensor:
        dx, dy = uv[..., 0] - x, uv[..., 1] - y
        return dx * dx + dy * dy

    with torch.no_grad():
        nearest = h.new_full((height, width), torch.inf)
        index = torch.full((height, width), -1, device=h.device)
        step = max(1, _CHUNK // (height * width))
        for first in range(0, h.shape[0], step):
            chunk = slice(first, first + step)
            candidate = drawn[chunk, None, None] & (squared_distance(uv[chunk, None, None]) < radius2)
            depth = torch.where(candidate, h[chunk, 2, None, None], torch.inf)
            nearest, index = _update(nearest, index, depth, first)

    seen = index >= 0
    d2 = squared_distance(uv[index.clamp(min=0)]) if h.shape[0] else h.new_zeros(height, width)
    return index.int(), torch.where(seen, d2, 0)


def _edges(h: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Lines opposite to the corners of each face, [M, 3, (a, b, c)], positive inside, and determinants, [M].

    The line through homogeneous points p and q is p × q; a face has its corners at p_k, the lines p_{k+1} ×
    p_{k+2} and the determinant p_0 · (p_1 × p_2), whose sign is taken out of both.
    """
    p = h.double()[faces.long()]  # [M, 3, 3]
    lines = torch.linalg.cross(p.roll(-1, 1), p.roll(-2, 1))
    determinant = (p[:, 0] * lines[:, 0]).sum(-1)
    sign = torch.where(determinant < 0, -1.0, 1.0)
    return lines * sign[:, None, None], determinant * sign


def rasterize_faces(h: Tensor, faces: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """See nmbg.ops.rasterize_faces()."""
    x, y = _centres(height, width, h.double())
    lines, determinant = _edges(h, faces)
    # A centre on a line counts as if moved by (ε, ε²).
    owns = (lines[..., 0] > 0) | ((lines[..., 0] == 0) & (lines[..., 1] > 0))  # [M, 3]
    drawn = (determinant > 0) & determinant.isfinite() & h[faces.long()].isfinite().all(-1).all(-1)

    def edge_values(lines: Tensor, k: int) -> Tensor:
        a, b, c = lines[..., k, :].unbind(-1)
        return a * x + (b * y + c)

    with torch.no_grad():
        nearest = x.new_full((height, width), torch.inf)
        face = torch.full((height, width), -1, device=h.device)
        step = max(1, _CHUNK // (height * width))
        for first in range(0, faces.shape[0], step):
            chunk = slice(first, first + step)
            e = [edge_values(lines[chunk, None, None], k) for k in range(3)]
            inside = drawn[chunk, None, None]
            for k in range(3):
                inside = inside & ((e[k] > 0) | ((e[k] == 0) & owns[chunk, k, None, None]))
            z = determinant[chunk, None, None] / (e[0] + e[1] + e[2])
            nearest, face = _update(nearest, face, torch.where(inside, z, torch.inf), first)

    bary = x.new_zeros(height, width, 3)
    row, column = torch.nonzero(face >= 0, as_tuple=True)
    a, b, c = lines[face[row, column]].unbind(-1)  # [S, 3] each
    e_seen = a * x[0, column, None] + (b * y[row] + c)
    bary = bary.index_put((row, column), e_seen / e_seen.sum(-1, keepdim=True))
    return face.int(), bary.to(h.dtype)


def harmonics(d: Tensor, basis: int) -> Tensor:
    """The first 1, 4 or 9 real spherical harmonics at unit directions [..., 3] → [..., basis]."""
    if basis not in (1, 4, 9):
        raise ValueError(f"coeffs: expected 1, 4 or 9 basis functions, got {basis}")
    x, y, z = d.unbind(-1)
    values = [
        torch.full_like(x, 0.28209479177387814),
        -0.48860251190291992 * y,
        0.48860251190291992 * z,
        -0.48860251190291992 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.54627421529603959 * (x * x - y * y),
    ]
    return torch.stack(values[:basis], -1)


def _shade(seen: Tensor, vertices: Tensor, weight: Tensor, rays: Tensor, coeffs: Tensor) -> Tensor:
    """seen [H, W] bool; of the S seen pixels: vertices [S, K], weight [S, K] → [C, H, W]."""
    Y = harmonics(rays[seen], coeffs.shape[1])  # [S, B]
    features = torch.einsum("sk,sb,skbc->sc", weight, Y, coeffs[vertices.long()])
    out = coeffs.new_zeros(*seen.shape, coeffs.shape[2])
    return out.index_put((seen,), features).permute(2, 0, 1)


def shade_points(index: Tensor, weight: Tensor, rays: Tensor, coeffs: Tensor) -> Tensor:
    """See nmbg.ops.shade_points()."""
    seen = index >= 0
    return _shade(seen, index[seen][:, None], weight[seen][:, None], rays, coeffs)


def shade_faces(face: Tensor, bary: Tensor, faces: Tensor, rays: Tensor, coeffs: Tensor) -> Tensor:
    """See nmbg.ops.shade_faces()."""
    seen = face >= 0
    return _shade(seen, faces[face[seen].long()], bary[seen], rays, coeffs)
