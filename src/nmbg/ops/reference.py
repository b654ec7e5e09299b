"""The ops in plain torch, one expression per rule: the specification of the kernels.

Same names, arguments and results as nmbg.ops. Every item is tested against every pixel, in chunks of bounded
memory; gradients are torch's own.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from nmbg.ops.blend import Blend, traced
from nmbg.ops.rasterize import FaceHits, PointHits

__all__ = [
    "adam_rows",
    "blend_photos",
    "gate",
    "harmonics",
    "project",
    "rasterize_faces",
    "rasterize_faces_pyramid",
    "rasterize_points",
    "rasterize_points_pyramid",
    "shade_faces",
    "shade_points",
]

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


def project(points: Tensor, P: Tensor) -> Tensor:
    """See nmbg.ops.project()."""
    P = P.to(points.device)
    return torch.addmm(P[:, 3], points.double(), P[:, :3].T).to(points.dtype)


def pixel_rays(M: Tensor, height: int, width: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """See nmbg.ops.pixel_rays(); not rounded on the way."""
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    pixels = torch.stack([x, y, torch.ones_like(x)], -1).double()
    return torch.nn.functional.normalize(pixels @ M.T, dim=-1).to(dtype)


def rasterize_points(h: Tensor, radius_px: float, height: int, width: int) -> PointHits:
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
    return PointHits(index.int(), torch.where(seen, d2, 0))


def rasterize_points_pyramid(
    h: Tensor, radius_px: float, height: int, width: int, levels: int
) -> list[PointHits]:
    """See nmbg.ops.rasterize_points_pyramid()."""
    return [
        rasterize_points(part, radius_px, -(-height // 2**k), -(-width // 2**k))
        for k, part in enumerate(_halved(h, levels))
    ]


def _halved(h: Tensor, levels: int) -> list[Tensor]:
    """Homogeneous pixels of each level."""
    return [h * h.new_tensor([0.5**k, 0.5**k, 1]) for k in range(levels)]


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


def rasterize_faces(h: Tensor, faces: Tensor, height: int, width: int) -> FaceHits:
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
    corner_z = h.double()[:, 2][faces.long()[face.clamp(min=0)]] if faces.shape[0] else torch.zeros_like(bary)
    depth = (bary * corner_z.nan_to_num()).sum(-1)
    return FaceHits(face.int(), bary.to(h.dtype), depth.to(h.dtype))


def rasterize_faces_pyramid(h: Tensor, faces: Tensor, height: int, width: int, levels: int) -> list[FaceHits]:
    """See nmbg.ops.rasterize_faces_pyramid()."""
    return [
        rasterize_faces(part, faces, -(-height // 2**k), -(-width // 2**k))
        for k, part in enumerate(_halved(h, levels))
    ]


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


_LEAST_ANGLE = 1e-3  # below it angles do not tell sources apart: rounds off the cone at zero
_LEAST_SHARE = 1e-4  # of a source's own score that counts even when the next one scores the same
_SHARPNESS = 0.5  # halvings by which the level read is finer than the view: bilinear weights blur, too


def _corners(u: Tensor, v: Tensor, width: Tensor, height: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
    """The four pixels around places u, v [S, H, W] in images [S, 1, 1] of this size that begin at `first`.

    Returns:
        their rows in the buffer of all images and their bilinear weights, [4, S, H, W] each.
    """
    i, j = (u - 0.5).floor().detach(), (v - 0.5).floor().detach()
    fx, fy = u - 0.5 - i, v - 0.5 - j
    x = torch.stack([i, i + 1, i, i + 1]).long().clamp(min=0).minimum(width - 1)
    y = torch.stack([j, j, j + 1, j + 1]).long().clamp(min=0).minimum(height - 1)
    weight = torch.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy])
    return first + y * width + x, weight


def _joined(images: Sequence[Tensor], channels: int, like: Tensor) -> tuple[Tensor, Tensor]:
    """All images as one [rows, channels] in the dtype of `like`, and the row where each begins, [S, 1, 1]."""
    rows = [image.reshape(-1, channels) for image in images]
    lengths = torch.tensor([len(image) for image in rows], dtype=torch.int64, device=like.device)
    first = (lengths.cumsum(0) - lengths)[:, None, None]
    ones = [255 if image.dtype == torch.uint8 else 1 for image in rows]
    rows = [image.to(like.dtype) / one for image, one in zip(rows, ones, strict=True)]
    return torch.cat([like.new_zeros(0, channels), *rows]), first


def blend_photos(
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    focal: float,
    photos: Sequence[Tensor],
    photo_depths: Sequence[Tensor],
    keep: int = 5,
    angle: float = 0.1,
    tolerance: float = 0.02,
    border: float = 8.0,
    each: bool = False,
) -> Blend:
    """See nmbg.ops.blend_photos()."""
    texels, first_texel = _joined(photos, 4, depth)
    texels = texels[:, :3]
    surfaces, first_surface = _joined(photo_depths, 1, depth)
    sizes = torch.tensor([surface.shape for surface in photo_depths], dtype=torch.int64, device=depth.device)
    height, width = sizes.reshape(-1, 2)[:, :, None, None].unbind(1)

    # The point in each source's camera, [S, H, W, 3], and the new view's ray there, of any length.
    x, y = _centres(depth.shape[0], depth.shape[1], depth)
    one = torch.ones_like(depth)
    pixel = torch.stack([x * one, y * one, one], -1)
    z = torch.where((depth > 0) & depth.isfinite(), depth, 0)
    ray = torch.einsum("sij,hwj->shwi", warps[:, :, :3], pixel)
    point = z[..., None] * ray + warps[:, None, None, :, 3]
    front = (point[..., 2] > 0) & (z > 0)
    g = torch.where(front[..., None], point, 1.0)

    # Where the source sees it, held within a pixel of the photograph.
    K = intrinsics[:, :, :, None, None]
    u = (K[:, 0, 0] * g[..., 0] + K[:, 0, 1] * g[..., 1]) / g[..., 2] + K[:, 0, 2]
    v = K[:, 1, 1] * g[..., 1] / g[..., 2] + K[:, 1, 2]
    u, v = u.clamp(min=-1).minimum(width + 1), v.clamp(min=-1).minimum(height + 1)
    u, v = torch.where(u.isnan(), -1, u), torch.where(v.isnan(), -1, v)

    # The factors of the score.
    inside = u.minimum(width - u).minimum(v.minimum(height - v))
    along = torch.nn.functional.normalize(g, dim=-1) - torch.nn.functional.normalize(ray, dim=-1)
    theta = ((along**2).sum(-1) + _LEAST_ANGLE**2).sqrt()
    finer = K[:, 0, 0] / focal * z / g[..., 2]
    at, share = _corners(u, v, width, height, first_surface)
    surface = surfaces[at, 0].where(surfaces[at, 0].isfinite(), 0)
    off = (g[..., 2] - surface).abs() / (tolerance * torch.where(surface > 0, surface, 1))
    share = share * torch.where(surface > 0, (2 - off).clamp(0, 1), 0)
    visible = share.sum(0)
    score = visible * (inside / border).clamp(0, 1) * (1 + theta / angle) ** -4 * finer.clamp(max=1)
    seen = front & (score > 0)
    score = torch.where(seen, score, 0)

    # The colour that each source shows: at the finest level from the visible surface, then from ever smaller
    # copies, linear between the two levels that are next to `level`.
    smallest = height.maximum(width).double().log2().ceil().long()
    level = (finer.clamp(min=1).log2() - _SHARPNESS).clamp(min=0).minimum(smallest)
    shown = depth.new_zeros(*point.shape)
    for k in range(int(smallest.max()) + 1 if len(photos) else 0):
        at, weight = _corners(u / 2**k, v / 2**k, width, height, first_texel)
        if k == 0:
            weight = share / torch.where(seen, visible, 1)
        of_level = torch.where(k <= smallest, (1 - (level - k).abs()).clamp(min=0), 0)
        rows = torch.where(k <= smallest, at, 0)
        shown = shown + of_level[..., None] * (weight[..., None] * texels[rows]).sum(0)
        first_texel = first_texel + width * height
        width, height = (width + 1) // 2, (height + 1) // 2
    shown = torch.where(seen[..., None], shown, 0)

    # The best, from the best score down; equal ones by index. Each counts what it exceeds the next one by.
    spare = depth.new_zeros(keep + 1, *depth.shape)
    score, sources = torch.cat([score, spare]).sort(dim=0, descending=True, stable=True)
    score, sources = score[: keep + 1], torch.where(score > 0, sources, -1)[: keep + 1]
    shown = torch.cat([shown, spare[..., None].expand(-1, -1, -1, 3)])
    shown = shown.gather(0, sources[:keep, ..., None].clamp(min=0).expand(-1, -1, -1, 3))
    shown = torch.where(sources[:keep, ..., None] >= 0, shown, 0).permute(0, 3, 1, 2)  # [keep, 3, H, W]
    weights = (score[:keep] - (1 - _LEAST_SHARE) * score[keep]).clamp(min=0)
    total = weights.sum(0)
    weights = weights / torch.where(total > 0, total, 1)
    colour = (weights[:, None] * shown).sum(0)
    variance = (weights * ((shown - colour) ** 2).mean(1)).sum(0)
    which = keep + 1 if each or traced(depth, warps, *photos) else 0
    return Blend(
        colour,
        score[0],
        variance,
        sources[:which].permute(1, 2, 0).int(),
        weights[: keep if each else 0].detach(),
        shown[: keep if each else 0].detach(),
    )


def adam_rows(
    table: Tensor,
    mean: Tensor,
    square: Tensor,
    index: Tensor,
    grad: Tensor,
    rate: float,
    betas: tuple[float, float],
    eps: float,
) -> None:
    """See nmbg.ops.adam_rows()."""
    mean[index] = betas[0] * mean[index] + (1 - betas[0]) * grad
    square[index] = betas[1] * square[index] + (1 - betas[1]) * grad**2
    table[index] -= rate * mean[index] / (square[index].sqrt() + eps)


def gate(x: Tensor) -> Tensor:
    """See nmbg.ops.gate()."""
    value, opening = x.chunk(2, dim=1)
    return torch.nn.functional.elu(value) * torch.sigmoid(opening)
