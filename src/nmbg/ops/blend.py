"""Blending photographs: what the sources that see a pixel's surface point best show there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch  # before nmbg._core: the process then has the one OpenMP runtime of torch
import torch.nn.functional as F
from torch import Tensor

from nmbg import _core
from nmbg.ops._arrays import array


class Blend(NamedTuple):
    """What blend_photos() returns.

    Args:
        colour: [3, H, W], 0 where no source sees the point.
        weight: [H, W] the best source's score, in [0, 1]: how well the point is seen.
        variance: [H, W] of the blended colours, mean over the channels.
        sources: [H, W, keep + 1] int32, from the best score down, −1 where there are no more; the last one is
            not shown, it only sets the weights.
        weights: [keep, H, W] of the first `keep` sources; they sum to one, or are 0. Not differentiable.
        shown: [keep, 3, H, W] the colours that the weights mix, 0 where there is none. Not differentiable.

    The last three are empty ([H, W, 0], [0, H, W], [0, 3, H, W]) when they are not asked for; `sources` are
    there as well when there may be gradients.
    """

    colour: Tensor
    weight: Tensor
    variance: Tensor
    sources: Tensor
    weights: Tensor
    shown: Tensor


Scalars = tuple[float, int, float, float, float]  # focal, keep, angle, tolerance, border


def _blending(
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    photos: Sequence[Tensor],
    photo_depths: Sequence[Tensor],
    scalars: Scalars,
) -> _core.Blending:
    focal, keep, angle, tolerance, border = scalars
    return _core.Blending(
        array("depth", depth),
        array("warps", warps),
        array("intrinsics", intrinsics),
        focal,
        [array("photos", photo) for photo in photos],
        [array("photo_depths", surface) for surface in photo_depths],
        keep,
        angle,
        tolerance,
        border,
        torch.get_num_threads(),
    )


# Values come before indices: torch.library.opcheck sums outputs into the first one.
@torch.library.custom_op("nmbg::blend_photos", mutates_args=(), device_types="cpu")
def _blend(
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    photos: Sequence[Tensor],
    photo_depths: Sequence[Tensor],
    focal: float,
    keep: int,
    angle: float,
    tolerance: float,
    border: float,
    each: bool,
    which: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    blending = _blending(
        depth, warps, intrinsics, photos, photo_depths, (focal, keep, angle, tolerance, border)
    )
    colour, weight, variance, sources, weights, shown = map(torch.from_numpy, blending.forward(each, which))
    return colour, weight, variance, weights, shown, sources


@_blend.register_fake
def _(
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    photos: Sequence[Tensor],
    photo_depths: Sequence[Tensor],
    focal: float,
    keep: int,
    angle: float,
    tolerance: float,
    border: float,
    each: bool,
    which: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    size = tuple(depth.shape)
    return (
        depth.new_empty((3, *size)),
        depth.new_empty(size),
        depth.new_empty(size),
        depth.new_empty((keep if each else 0, *size)),
        depth.new_empty((keep if each else 0, 3, *size)),
        depth.new_empty((*size, keep + 1 if which else 0), dtype=torch.int32),
    )


@torch.library.custom_op("nmbg::blend_photos_backward", mutates_args=(), device_types="cpu")
def _blend_backward(
    grad_colour: Tensor,
    grad_weight: Tensor,
    grad_variance: Tensor,
    sources: Tensor,
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    photos: Sequence[Tensor],
    photo_depths: Sequence[Tensor],
    focal: float,
    keep: int,
    angle: float,
    tolerance: float,
    border: float,
) -> tuple[Tensor, Tensor]:
    blending = _blending(
        depth, warps, intrinsics, photos, photo_depths, (focal, keep, angle, tolerance, border)
    )
    grads = [array("grad", grad) for grad in (grad_colour, grad_weight, grad_variance)]
    grad_depth, grad_warps = blending.backward(array("sources", sources), *grads)
    return torch.from_numpy(grad_depth), torch.from_numpy(grad_warps)


@_blend_backward.register_fake
def _(
    grad_colour: Tensor,
    grad_weight: Tensor,
    grad_variance: Tensor,
    sources: Tensor,
    depth: Tensor,
    warps: Tensor,
    *_: Any,
) -> tuple[Tensor, Tensor]:
    return depth.new_empty(depth.shape), warps.new_empty(warps.shape)


@torch.library.custom_op("nmbg::blend_photos_backward_texels", mutates_args=(), device_types="cpu")
def _blend_backward_texels(
    grad_colour: Tensor,
    grad_weight: Tensor,
    grad_variance: Tensor,
    sources: Tensor,
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    photos: Sequence[Tensor],
    photo_depths: Sequence[Tensor],
    focal: float,
    keep: int,
    angle: float,
    tolerance: float,
    border: float,
) -> list[Tensor]:
    blending = _blending(
        depth, warps, intrinsics, photos, photo_depths, (focal, keep, angle, tolerance, border)
    )
    grads = [array("grad", grad) for grad in (grad_colour, grad_weight, grad_variance)]
    return [torch.from_numpy(grad) for grad in blending.backward_texels(array("sources", sources), *grads)]


@_blend_backward_texels.register_fake
def _(
    grad_colour: Tensor,
    grad_weight: Tensor,
    grad_variance: Tensor,
    sources: Tensor,
    depth: Tensor,
    warps: Tensor,
    intrinsics: Tensor,
    photos: Sequence[Tensor],
    *_: Any,
) -> list[Tensor]:
    return [photo.new_empty(photo.shape) for photo in photos]


def _save(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    depth, warps, intrinsics, photos, photo_depths, *scalars, _, _ = inputs
    ctx.scalars = scalars
    *_, weights, shown, sources = output
    ctx.mark_non_differentiable(weights, shown, sources)
    ctx.n_photos = len(photos)
    ctx.save_for_backward(sources, depth, warps, intrinsics, *photos, *photo_depths)


def _grad(
    ctx: Any, grad_colour: Tensor, grad_weight: Tensor, grad_variance: Tensor, *_: Any
) -> tuple[Any, ...]:
    sources, depth, warps, intrinsics, *rest = ctx.saved_tensors
    photos, photo_depths = list(rest[: ctx.n_photos]), list(rest[ctx.n_photos :])
    grads = (grad_colour, grad_weight, grad_variance)
    arguments = (*grads, sources, depth, warps, intrinsics, photos, photo_depths, *ctx.scalars)
    grad_depth = grad_warps = grad_photos = None
    if ctx.needs_input_grad[0] or ctx.needs_input_grad[1]:
        grad_depth, grad_warps = _blend_backward(*arguments)
    if any(ctx.needs_input_grad[3]):
        grad_photos = _blend_backward_texels(*arguments)
    return (
        grad_depth,
        grad_warps,
        None,
        grad_photos or [None] * len(photos),
        [None] * len(photos),
        *[None] * 7,
    )


_blend.register_autograd(_grad, setup_context=_save)


def blend_photos(
    depth: Tensor,  # [H, W]
    warps: Tensor,  # [S, 3, 4]
    intrinsics: Tensor,  # [S, 3, 3]
    focal: float,
    photos: Sequence[Tensor],  # S × [texels, 4]
    photo_depths: Sequence[Tensor],  # S × [h, w]
    keep: int = 5,
    angle: float = 0.1,
    tolerance: float = 0.02,
    border: float = 8.0,
    each: bool = False,
) -> Blend:
    """What photographs show of the surface that a new view sees.

    The surface point of a pixel is projected into each photograph. A source's score is the product of
    visibility (its own depth against the point's: 1 up to `tolerance`, 0 from twice as much on, bilinear over
    four pixels), border (rising over `border` pixels), angle between the rays (1 / (1 + θ / `angle`)⁴) and
    resolution (source pixels per pixel of the new view, at most 1). The `keep` best are blended, weighted by
    what their score exceeds the next one's by: with more than one continuous in the point and in the cameras.
    Equal scores go by index. Colours come from the mip level that fits, at the finest from texels of the
    visible surface alone.

    Args:
        depth: [H, W] float32 or float64, view-space z of the new view, 0 where it sees nothing.
        warps: [S, 3, 4] in the dtype of `depth`: [B | c], so that pixel (x, y) at depth z lies at
            z·B·(x, y, 1) + c in the source's camera: B = R_s Rᵀ K⁻¹, c = R_s C + t_s.
        intrinsics: [S, 3, 3] in the dtype of `depth`, upper triangular, pixels.
        focal: of the new view, pixels.
        photos: a mip chain (`mip_chain`) per source, [texels, 4]; all uint8, shown as [0, 1], or all in the
            dtype of `depth`. The fourth value is not read. Sizes may differ.
        photo_depths: per source, [h, w] in the dtype of `depth`: view-space z of the surface that it sees, 0
            where it sees none or its pixels do not count.
        keep: sources blended in a pixel, 1 to 15.
        angle: radians.
        tolerance: relative.
        border: pixels.
        each: return what the single sources show, their weights and which they are too.

    Returns:
        see Blend; colour, weight and variance are differentiable with respect to `depth`, `warps` and
        floating `photos`.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or range than said here.
    """
    colour, weight, variance, weights, shown, sources = _blend(
        depth,
        warps,
        intrinsics,
        list(photos),
        list(photo_depths),
        focal,
        keep,
        angle,
        tolerance,
        border,
        each,
        each or traced(depth, warps, *photos),
    )
    return Blend(colour, weight, variance, sources, weights, shown)


def traced(*inputs: Tensor) -> bool:
    """Whether gradients to any of them may be asked for."""
    return torch.is_grad_enabled() and any(x.requires_grad for x in inputs)


def mip_chain(image: Tensor, mask: Tensor | None = None) -> Tensor:
    """A photograph and its ever smaller copies in one buffer, finest first; sizes are halved, rounded up.

    Args:
        image: [h, w, 3] uint8 or floating.
        mask: [h, w] bool, true where the photograph counts: smaller copies average only that.

    Returns:
        [texels, 4] in the dtype of `image`: three colours and a 0, so that four bytes are read at once.
    """
    level = image.permute(2, 0, 1)[None].to(torch.float32 if image.dtype == torch.uint8 else image.dtype)
    weight = None if mask is None else mask[None, None].to(level.dtype)
    chain = [image.reshape(-1, 3)]
    while max(level.shape[2:]) > 1:
        odd = (0, level.shape[3] % 2, 0, level.shape[2] % 2)
        smaller = F.avg_pool2d(F.pad(level, odd, mode="replicate"), 2)
        if weight is not None:
            total = F.avg_pool2d(F.pad(weight, odd), 2)
            counted = F.avg_pool2d(F.pad(torch.where(weight > 0, level, 0), odd), 2)
            smaller = torch.where(total > 0, counted / total.clamp(min=1e-12), smaller)
            weight = (total > 0).to(level.dtype)
        level = smaller
        texels = level[0].permute(1, 2, 0).reshape(-1, 3)
        chain.append(texels.round().to(torch.uint8) if image.dtype == torch.uint8 else texels)
    return F.pad(torch.cat(chain), (0, 1))
