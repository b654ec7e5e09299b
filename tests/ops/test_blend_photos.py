from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.ops import Blend, blend_photos, mip_chain, reference

DTYPES = (torch.float32, torch.float64)
OPS = pytest.mark.parametrize("op", [blend_photos, reference.blend_photos])

# A wall that stands a little askew, and a box in front of it: z = wall · (x, y, 1), |(x, y)| ≤ box at z = 2.
WALL, BOX, BOX_Z = (0.3, -0.2, 4.0), (0.5, 0.4), 2.0


def camera(centre=(0.0, 0.0, 0.0), yaw=0.0, pitch=0.0, width=20, height=14, focal=16.0) -> Camera:
    a, b = np.array([np.cos(yaw), np.sin(yaw)]), np.array([np.cos(pitch), np.sin(pitch)])
    R = np.array([[a[0], 0, -a[1]], [0, 1, 0], [a[1], 0, a[0]]])
    R = np.array([[1, 0, 0], [0, b[0], -b[1]], [0, b[1], b[0]]]) @ R
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(K, R, -R @ np.array(centre), width, height)


def surface(view: Camera, box: bool = True) -> Tensor:
    """What a camera sees of the scene: view-space z [H, W] float64, 0 behind."""
    x, y = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    d = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(view.K).T @ view.R
    C = view.centre
    normal = np.array([-WALL[0], -WALL[1], 1])
    z = (WALL[2] - normal @ C) / (d @ normal)
    z = np.where(z > 0, z, 0)
    at_box = (BOX_Z - C[2]) / d[..., 2]
    hit = (at_box > 0) & (np.abs((C + at_box[..., None] * d)[..., :2]) <= BOX).all(-1)
    return torch.tensor(np.where(hit & box, at_box, z))


def noise(view: Camera, seed: int) -> Tensor:
    return torch.rand(view.height, view.width, 3, generator=torch.Generator().manual_seed(seed)).double()


def geometry(new: Camera, sources, dtype=torch.float64):
    B = [s.R @ new.R.T @ np.linalg.inv(new.K) for s in sources]
    c = [s.R @ new.centre + s.t for s in sources]
    warps = [np.concatenate([b, d[:, None]], 1) for b, d in zip(B, c, strict=True)]
    warps = torch.tensor(np.array(warps).reshape(-1, 3, 4), dtype=dtype)
    return warps, torch.tensor(np.array([s.K for s in sources]).reshape(-1, 3, 3), dtype=dtype)


def problem(new: Camera, sources, photos=None, dtype=torch.float64, texel=None, box=True):
    """Arguments of blend_photos(); photographs are noise unless they are given, [h, w, 3] in [0, 1]."""
    photos = [noise(s, i) for i, s in enumerate(sources)] if photos is None else photos
    if texel == torch.uint8:
        photos = [(255 * photo).round() for photo in photos]
    chains = [mip_chain(photo.to(texel or dtype)) for photo in photos]
    warps, K = geometry(new, sources, dtype)
    depths = [surface(s, box).to(dtype) for s in sources]
    return [surface(new, box).to(dtype), warps, K, float(new.K[0, 0]), chains, depths]


def random_sources(seed: int, count: int) -> list[Camera]:
    """Cameras of all sizes and focal lengths, with pixels that are neither square nor upright."""
    g = np.random.default_rng(seed)
    sources = [
        camera(
            g.uniform([-0.8, -0.5, -1.5], [0.8, 0.5, 1.2]),
            *g.uniform(-0.15, 0.15, 2),
            width=int(g.integers(7, 60)),
            height=int(g.integers(6, 45)),
            focal=g.uniform(6, 70),
        )
        for _ in range(count)
    ]
    skews = np.random.default_rng(seed + 1).uniform(-0.1, 0.1, (count, 2))
    return [
        replace(s, K=s.K @ np.array([[1, skew, 0], [0, 1 + aspect, 0], [0, 0, 1]]))
        for s, (skew, aspect) in zip(sources, skews, strict=True)
    ]


def run(op, arguments, **options) -> tuple[Blend, list[Tensor]]:
    """The blend, and gradients of a random sum to depth, warps and floating photographs."""
    depth, warps, K, focal, photos, depths = arguments
    depth, warps = depth.clone().requires_grad_(), warps.clone().requires_grad_()
    photos = [photo.clone().requires_grad_(photo.is_floating_point()) for photo in photos]
    blend = op(depth, warps, K, focal, photos, depths, each=True, **options)
    g = torch.Generator().manual_seed(3)
    smooth = blend[:3]
    weights = [torch.randn(o.shape, generator=g, dtype=torch.float64).to(o.dtype) for o in smooth]
    leaves = [depth, warps, *[p for p in photos if p.requires_grad]]
    grads = torch.autograd.grad(smooth, leaves, weights, allow_unused=not photos)
    grads = [torch.zeros_like(x) if d is None else d for x, d in zip(leaves, grads, strict=True)]
    return Blend(*[o.detach() for o in blend]), grads


def assert_close(a: Tensor, b: Tensor, atol: float) -> None:
    assert a.dtype == b.dtype
    scale = max(1.0, float(b.abs().max())) if b.numel() else 1.0
    torch.testing.assert_close(a / scale, b / scale, rtol=0, atol=atol)


def assert_empty(blend: Blend, where=...) -> None:
    assert (blend.colour[:, where] == 0).all()
    assert (blend.weight[where] == 0).all()
    assert (blend.variance[where] == 0).all()
    assert (blend.weights[:, where] == 0).all()
    assert (blend.sources[where] == -1).all()


NEW = camera((0.1, 0.05, 0.0), yaw=0.05)


@pytest.mark.parametrize("texel", [torch.uint8, torch.float64])
@pytest.mark.parametrize(
    ("seed", "count", "keep"), [(0, 9, 3), (1, 4, 5), (2, 12, 1), (3, 20, 15), (6, 1, 5)]
)
def test_agrees_with_the_twin(texel, seed, count, keep):
    arguments = problem(NEW, random_sources(seed, count), texel=texel)
    options = {"keep": keep, "border": 2.0, "angle": 0.3, "tolerance": 0.1}
    (ours, our_grads), (twins, twin_grads) = [
        run(op, arguments, **options) for op in (blend_photos, reference.blend_photos)
    ]
    assert (ours.weight > 0).double().mean() > 0.1
    for a, b in zip(ours, twins, strict=True):
        if a.is_floating_point():
            assert_close(a, b, 1e-9)
        else:
            assert torch.equal(a, b)
    assert len(our_grads) == 2 + (count if texel == torch.float64 else 0)
    for a, b in zip(our_grads, twin_grads, strict=True):
        assert_close(a, b, 1e-9)


@pytest.mark.parametrize("texel", [torch.uint8, torch.float32])
@pytest.mark.parametrize("seed", range(3))
def test_agrees_with_the_twin_in_float32(texel, seed):
    arguments = problem(NEW, random_sources(seed, 9), dtype=torch.float32, texel=texel)
    options = {"keep": 3, "border": 2.0, "angle": 0.3, "tolerance": 0.1}
    (ours, our_grads), (twins, twin_grads) = [
        run(op, arguments, **options) for op in (blend_photos, reference.blend_photos)
    ]
    assert (ours.sources == twins.sources).double().mean() > 0.99  # rounding may order near equals
    assert_close(ours.weight, twins.weight, 1e-5)
    # Weights are differences of scores, which enlarge rounding where the scores are nearly equal; slopes jump
    # where rounding puts a place into the next pixel.
    assert ((ours.colour - twins.colour).abs() < 1e-3).double().mean() > 0.995
    assert ((ours.variance - twins.variance).abs() < 1e-3).double().mean() > 0.995
    for a, b in zip(our_grads, twin_grads, strict=True):
        assert a.isfinite().all()
        assert ((a - b).abs() <= 1e-3 * b.abs().max() + 1e-6).double().mean() > 0.97


def test_the_random_scenes_reach_coarse_levels():
    depth, warps, K, focal, *_ = problem(NEW, random_sources(0, 9))
    z = depth * warps[:, 2, 2, None, None] + warps[:, 2, 3, None, None]
    level = (K[:, 0, 0, None, None] / focal * depth / z).log2() - 0.5
    for least, most in ((-9, 0), (0, 1), (1, 9)):
        assert ((least < level) & (level < most)).any()


@OPS
@pytest.mark.parametrize("dtype", DTYPES)
def test_without_sources_nothing_is_shown(op, dtype):
    arguments = problem(NEW, [], dtype=dtype)
    blend, (grad_depth, grad_warps) = run(op, arguments)
    assert blend.colour.shape == (3, 14, 20)
    assert blend.sources.shape == (14, 20, 6)
    assert blend.shown.shape == (5, 3, 14, 20)
    assert_empty(blend)
    assert (grad_depth == 0).all()
    assert grad_warps.shape == (0, 3, 4)
    assert {o.dtype for o in blend} == {dtype, torch.int32}
    assert op(*arguments).shown.shape == (0, 3, 14, 20)


@OPS
@pytest.mark.parametrize("hide", ["behind", "beside", "unknown", "nearer", "not a number", "infinite"])
def test_what_no_source_sees_is_zero_and_never_nan(op, hide):
    sources = [camera((0.2 * i, 0, 0), focal=14.0) for i in range(3)]
    if hide == "behind":
        sources = [
            replace(s, R=np.diag([-1.0, 1, -1]) @ s.R, t=np.diag([-1.0, 1, -1]) @ s.t) for s in sources
        ]
    if hide == "beside":
        sources = [camera((0, 0, 0), yaw=1.5), camera((90, 0, 0)), camera((0, -90, 1))]
    arguments = problem(NEW, sources)
    depths = arguments[5]
    if hide == "unknown":
        arguments[5] = [torch.zeros_like(d) for d in depths]
    if hide == "nearer":
        arguments[5] = [0.9 * d for d in depths]
    if hide == "not a number":
        arguments[5] = [d * torch.nan for d in depths]
    if hide == "infinite":
        arguments[5] = [d * torch.inf for d in depths]
    blend, grads = run(op, arguments)
    assert_empty(blend)
    assert (blend.shown == 0).all()
    assert all((grad == 0).all() for grad in grads)


@OPS
def test_pixels_without_a_depth_are_zero_and_others_do_not_notice(op):
    arguments = problem(NEW, random_sources(0, 5))
    expected, _ = run(op, arguments, border=2.0)
    holes = torch.zeros(14, 20, dtype=torch.bool)
    for i, value in enumerate([0.0, -1.0, torch.nan, torch.inf, -torch.inf]):
        arguments[0][i + 2, 5:15] = value
        holes[i + 2, 5:15] = True
    blend, grads = run(op, arguments, border=2.0)
    assert_empty(blend, holes)
    for ours, theirs in zip(blend[:3], expected[:3], strict=True):
        assert torch.equal(ours[..., ~holes], theirs[..., ~holes])
    assert (grads[0][holes] == 0).all()
    assert all(grad.isfinite().all() for grad in grads)


@pytest.mark.parametrize("what", ["warps", "intrinsics"])
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_source_with_a_broken_camera_is_not_seen(what, value, dtype):
    arguments = problem(NEW, [NEW, NEW, NEW], dtype=dtype)
    expected = blend_photos(*problem(NEW, [NEW, NEW], dtype=dtype), each=True)
    broken = arguments[("depth", "warps", "intrinsics").index(what)]
    for index in [(0, 0), (0, 2), (1, 1), (2, 2)] if what == "warps" else [(0, 0), (0, 2), (1, 1), (1, 2)]:
        kept = broken.clone()
        broken[2][index] = value
        blend = blend_photos(*arguments, each=True)
        assert torch.equal(blend.colour, expected.colour)
        assert torch.equal(blend.sources, expected.sources)
        broken.copy_(kept)


def tiny(photos: bool = False) -> list:
    """A scene of few pixels: sources that see the wall from all sides, one of them at coarse levels."""
    new = camera((0.02, 0.03, 0), width=5, height=4, focal=5.0)
    sources = [
        camera((0.4, 0.1, 0), yaw=0.03, width=8, height=7, focal=5.3),
        camera((-0.3, 0.2, 0.3), yaw=-0.04, width=9, height=8, focal=6.1),
        camera((0.1, -0.3, -0.5), pitch=0.05, width=6, height=7, focal=5.1),
        camera((-0.11, -0.23, 0.4), pitch=-0.05, width=24, height=21, focal=17.0),
    ]
    if photos:
        sources = [sources[0], camera((-0.11, -0.23, 0.4), width=12, height=11, focal=9.0)]
    return problem(new, sources, box=False)


def test_gradients_are_the_derivatives():
    depth, warps, K, focal, photos, depths = tiny()
    options = {"keep": 2, "border": 3.0, "angle": 0.3, "tolerance": 0.05}
    # Depths a little off the surface: partly visible.
    depth = depth * (1 + 0.05 * torch.rand(depth.shape, generator=torch.Generator().manual_seed(1)))

    def smooth(depth: Tensor, warps: Tensor) -> tuple[Tensor, ...]:
        return blend_photos(depth, warps, K, focal, photos, depths, **options)[:3]

    assert (smooth(depth, warps)[1] > 0).all()
    assert torch.autograd.gradcheck(smooth, (depth.requires_grad_(), warps.requires_grad_()), atol=1e-4)


def test_gradients_to_photographs_are_the_derivatives():
    depth, warps, K, focal, photos, depths = tiny(photos=True)

    def smooth(*photos: Tensor) -> tuple[Tensor, ...]:
        return blend_photos(depth, warps, K, focal, photos, depths, keep=2, border=3.0)[:3]

    assert torch.autograd.gradcheck(smooth, [photo.requires_grad_() for photo in photos])
    grads = torch.autograd.grad(smooth(*photos)[0].sum(), photos)
    assert (grads[1][12 * 11 :] > 0).any()  # coarse levels, too
    # Weights sum to one, over sources and over texels.
    torch.testing.assert_close(grads[0].sum() + grads[1].sum(), torch.tensor(60.0, dtype=torch.float64))


def test_gradients_come_for_what_needs_them():
    depth, warps, K, focal, photos, depths = tiny()
    _, (grad_depth, grad_warps, *grad_photos) = run(blend_photos, tiny())
    g = torch.Generator().manual_seed(3)
    size = depth.shape
    weights = [torch.randn(s, generator=g, dtype=torch.float64) for s in ((3, *size), size, size)]
    for i, expected in enumerate((grad_depth, grad_warps, grad_photos[2])):
        leaf = (depth, warps, photos[2])[i].clone().requires_grad_()
        args = (leaf if i == 0 else depth, leaf if i == 1 else warps, K, focal)
        chains = [*photos[:2], leaf if i == 2 else photos[2], photos[3]]
        blend = blend_photos(*args, chains, depths)
        assert not any(o.requires_grad for o in blend[3:])
        (grad,) = torch.autograd.grad(blend[:3], leaf, weights)
        assert torch.equal(grad, expected)
    leaf = depth.clone().requires_grad_()
    blend_photos(leaf, warps, K, focal, photos, depths).weight.sum().backward()
    assert (leaf.grad != 0).any()
    assert not blend_photos(depth, warps, K, focal, photos, depths).colour.requires_grad


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 8), keep=st.integers(1, 4))
def test_photographs_of_one_colour_give_that_colour(seed, count, keep):
    colour = torch.tensor([0.2, 0.5, 0.7], dtype=torch.float64)
    sources = random_sources(seed, count)
    photos = [colour.expand(s.height, s.width, 3) for s in sources]
    blend = blend_photos(*problem(NEW, sources, photos), keep=keep, border=2.0)
    seen = blend.weight > 0
    torch.testing.assert_close(blend.colour, colour[:, None, None] * seen, rtol=0, atol=1e-12)
    assert blend.variance.max() < 1e-24


@OPS
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("texel", [torch.uint8, None])
def test_the_view_itself_reproduces_its_photograph(op, dtype, texel):
    arguments = problem(NEW, [NEW], dtype=dtype, texel=texel)
    photo = arguments[4][0][: 14 * 20, :3].to(dtype) / (255 if texel == torch.uint8 else 1)
    blend = op(*arguments, each=True)
    atol = 1e-12 if dtype == torch.float64 else 1e-5
    torch.testing.assert_close(blend.colour.permute(1, 2, 0).reshape(-1, 3), photo, rtol=0, atol=atol)
    assert (blend.weights[0] == 1).all()
    # All factors are one but the border's, 6.5 of 8 px, and that of the angle, which is rounded off.
    assert blend.weight.max() == pytest.approx(1.01**-4 * 6.5 / 8, rel=1e-4)


def single_scores(arguments, **options) -> Tensor:
    """Scores [S, H, W] of the sources, each asked alone."""
    depth, warps, K, focal, photos, depths = arguments
    options["keep"] = 1
    return torch.stack(
        [
            blend_photos(depth, warps[i, None], K[i, None], focal, [photos[i]], [depths[i]], **options).weight
            for i in range(len(photos))
        ]
    )


@pytest.mark.parametrize("keep", [1, 3, 8])
def test_a_blend_is_made_of_what_its_sources_show_alone(keep):
    arguments = problem(NEW, random_sources(5, 8))
    options = {"border": 2.0, "angle": 0.3, "tolerance": 0.1}
    blend = blend_photos(*arguments, keep=keep, each=True, **options)
    score, order = single_scores(arguments, **options).sort(0, descending=True)
    score = torch.cat([score, torch.zeros_like(score)])
    order = torch.where(score[: len(order)] > 0, order, -1)
    assert torch.equal(blend.sources.permute(2, 0, 1).long()[: len(order)], order[: keep + 1])
    torch.testing.assert_close(blend.weight, score[0])
    assert (blend.weights >= 0).all()
    seen = (blend.weight > 0).double()
    assert seen.mean() > 0.3
    torch.testing.assert_close(blend.weights.sum(0), seen)
    above = (score[:keep] - 0.9999 * score[keep]).clamp(min=0)
    torch.testing.assert_close(blend.weights * above.sum(0), above)
    colour = (blend.weights[:, None] * blend.shown).sum(0)
    torch.testing.assert_close(blend.colour, colour)
    variance = (blend.weights[:, None] * (blend.shown - colour) ** 2).sum(0).mean(0)
    torch.testing.assert_close(blend.variance, variance)
    without = blend_photos(*arguments, keep=keep, **options)
    assert without.shown.shape[0] == 0
    for a, b in zip(without[:3], blend[:3], strict=True):
        assert torch.equal(a, b)


@OPS
def test_scores_follow_the_rule(op):
    # A wall at depth 2, straight ahead of a pixel that stands for itself.
    def score(
        centre=(0.0, 0.0, 0.0), yaw: float = 0.0, scale: float = 1.0, focal: float = 40.0, shift: float = 0.0
    ) -> float:
        K = np.array([[40.0, 0, 0.5], [0, 40.0, 0.5], [0, 0, 1]])
        source = camera(centre, yaw, width=40, height=40, focal=focal)
        source = replace(source, K=source.K + np.array([[0, 0, shift], [0, 0, 0], [0, 0, 0]]))
        new = Camera(K, np.eye(3), np.zeros(3), 1, 1)
        warps, K = geometry(new, [source])
        depth = torch.full((1, 1), 2.0, dtype=torch.float64)
        z = (warps[0, 2, 2] * 2 + warps[0, 2, 3]) * scale
        chain = mip_chain(torch.zeros(40, 40, 3, dtype=torch.float64))
        return float(op(depth, warps, K, 40.0, [chain], [z.expand(40, 40)]).weight)

    best = 1.01**-4  # the angle's cone is rounded off
    assert score() == pytest.approx(best)
    # Angle: a source turned about the point by 0.1.
    aside = (2 * np.sin(0.1), 0, 2 - 2 * np.cos(0.1))
    assert score(aside, -0.1) == pytest.approx(1 / 16, rel=2e-3)
    # Resolution: half as many pixels; more than enough do not count.
    assert score((0, 0, -2)) == pytest.approx(best / 2)
    assert score(focal=20.0) == pytest.approx(best / 2)
    assert score(focal=80.0) == pytest.approx(best)
    # Visibility: full up to 2 %, gone from 4 %, both ways.
    for sign in (-1, 1):
        assert score(scale=1 / (1 + sign * 0.019)) == pytest.approx(best)
        assert score(scale=1 / (1 + sign * 0.03)) == pytest.approx(best / 2)
        assert score(scale=1 / (1 + sign * 0.041)) == 0
    # Border: two of eight pixels.
    assert score(shift=18.0) == pytest.approx(best / 4)
    assert score(shift=-18.0) == pytest.approx(best / 4)
    assert score(shift=20.1) == 0


def test_a_point_behind_a_nearer_surface_takes_nothing():
    source = camera((0.7, 0.1, 0), yaw=-0.1, width=60, height=42, focal=45.0)
    depth, warps, K, *rest = problem(NEW, [source])
    blend = blend_photos(depth, warps, K, *rest, border=1.0, angle=9.0)
    wall = depth > 3
    x, y = torch.meshgrid(torch.arange(20) + 0.5, torch.arange(14) + 0.5, indexing="xy")
    p = torch.stack([x, y, torch.ones_like(x)], -1).double()
    g = torch.einsum("ij,hwj->hwi", warps[0, :, :3], p) * depth[..., None] + warps[0, :, 3]
    uv = (g @ K[0].T)[..., :2] / g[..., 2:]
    i, j = uv.floor().long().unbind(-1)
    inside = (i > 1) & (i < 58) & (j > 1) & (j < 40)
    theirs = rest[2][0][None, None]
    farthest = torch.nn.functional.max_pool2d(theirs, 3, 1, 1)[0, 0][j.clamp(0, 41), i.clamp(0, 59)]
    nearest = -torch.nn.functional.max_pool2d(-theirs, 3, 1, 1)[0, 0][j.clamp(0, 41), i.clamp(0, 59)]
    hidden, free = wall & inside & (farthest < 3), wall & inside & (nearest > 3)
    assert hidden.sum() > 5
    assert free.sum() > 20
    assert_empty(blend, hidden)
    assert (blend.weight[free] > 0.1).all()


@OPS
def test_colours_do_not_bleed_over_depth_edges(op):
    # A red box before a blue wall, in photographs no finer than the view.
    sources = [camera((x, y, -0.3), focal=15.0) for x, y in ((0.5, 0.1), (-0.4, 0.2), (0.1, -0.3))]
    red, blue = torch.tensor([[1.0, 0, 0], [0, 0, 1]], dtype=torch.float64)
    photos = [torch.where((surface(s) < 3)[..., None], red, blue) for s in sources]
    arguments = problem(NEW, sources, photos)
    blend = op(*arguments, border=1.0)
    seen, box = blend.weight > 0, arguments[0] < 3
    assert (seen & box).sum() > 20
    assert (seen & ~box).sum() > 100
    expected = torch.where(box, red[:, None, None], blue[:, None, None]) * seen
    torch.testing.assert_close(blend.colour, expected, rtol=0, atol=1e-12)


@OPS
def test_photographs_finer_than_the_view_are_averaged(op):
    # Four times as many pixels, of which every other one is white.
    source = replace(camera(width=80, height=56, focal=64.0), R=NEW.R, t=NEW.t)
    x, y = np.meshgrid(np.arange(80), np.arange(56))
    photo = torch.tensor((x + y) % 2.0)[..., None].expand(-1, -1, 3)
    blend = op(*problem(NEW, [source], [photo]))
    torch.testing.assert_close(blend.colour, torch.full_like(blend.colour, 0.5))
    # 4 × 4 pixels of one colour are what a pixel of the view covers: level 1.5 keeps most of it.
    photo = noise(NEW, 0).repeat_interleave(4, 0).repeat_interleave(4, 1)
    blend = op(*problem(NEW, [source], [photo]))
    colour = noise(NEW, 0).permute(2, 0, 1)
    assert torch.corrcoef(torch.stack([blend.colour.flatten(), colour.flatten()]))[0, 1] > 0.95


@OPS
@pytest.mark.parametrize("focal", [2.0, 4.0, 40.0])
def test_a_photograph_of_one_pixel_shows_its_colour(op, focal):
    # Its finest level is its coarsest, too, however near the source is.
    new = camera(width=3, height=3, focal=2.0)
    source = camera(width=1, height=1, focal=focal)
    photo = torch.tensor([0.2, 0.5, 0.7], dtype=torch.float64).expand(1, 1, 3)
    blend = op(*problem(new, [source], [photo], box=False))
    assert blend.weight[1, 1] > 0
    torch.testing.assert_close(blend.colour[:, 1, 1], photo[0, 0])


def jumps(colours, low: Tensor, high: Tensor) -> Tensor:
    """What is left of the change between two ends of a path when halving closes in on where most of it lies.

    colours: places on the path, [H, W] → [3, H, W], every pixel by itself.
    """
    a, b = colours(low), colours(high)
    for _ in range(40):
        middle = (low + high) / 2
        c = colours(middle)
        left = (c - a).abs().sum(0) > (b - c).abs().sum(0)
        low, high = torch.where(left, low, middle), torch.where(left, middle, high)
        a, b = torch.where(left, a, c), torch.where(left, c, b)
    return (a - b).abs().sum(0)


@pytest.mark.parametrize("seed", range(4))
def test_colours_change_continuously_with_the_depth(seed):
    # Points that travel along their rays pass photographs' borders, depth edges, mip levels and ranks.
    depth, *rest = problem(NEW, random_sources(seed, 12))
    options = {"keep": 3, "border": 2.0, "angle": 0.3, "tolerance": 0.1}

    def colours(z: Tensor) -> Tensor:
        blend = blend_photos(z, *rest, **options)
        return blend.colour * blend.weight  # as the last source goes, its weight fades and its colour stays

    starts = torch.linspace(0.8, 1.2, 9)
    ends = [blend_photos(depth * s, *rest, each=True, **options).sources for s in starts]
    assert all((a != b).any() for a, b in pairwise(ends))
    for a, b in pairwise(starts):
        jump = jumps(colours, depth * a, depth * b)
        assert jump.max() < 5e-4  # sources that change places keep a ten-thousandth of their scores


def test_colours_change_continuously_with_the_camera():
    sources = random_sources(7, 12)
    depth, _, K, focal, photos, depths = problem(NEW, sources)

    def blend(t: float) -> Blend:
        new = camera((0.1 + 0.3 * t, 0.05 - 0.1 * t, 0.2 * t), yaw=0.05 + 0.04 * t)
        return blend_photos(
            *(depth, geometry(new, sources)[0], K, focal, photos, depths),
            keep=3,
            border=2.0,
            tolerance=0.1,
            each=True,
        )

    def colours(t: float) -> Tensor:
        return (lambda b: b.colour * b.weight)(blend(t))

    assert (blend(0).sources != blend(1).sources).any(-1).double().mean() > 0.3
    for pixel in [(2, 3), (5, 10), (7, 7), (9, 16), (12, 12), (6, 13)]:
        low, high = 0.0, 1.0
        for _ in range(40):
            middle = (low + high) / 2
            a, c, b = (colours(t)[:, pixel[0], pixel[1]] for t in (low, middle, high))
            low, high = (low, middle) if (c - a).abs().sum() > (b - c).abs().sum() else (middle, high)
        assert (a - b).abs().sum() < 5e-4
    # And hardly at all over a step of a ten-thousandth.
    for t in np.linspace(0, 1, 11):
        assert (colours(t) - colours(t + 1e-4)).abs().mean() < 2e-3


@OPS
@pytest.mark.parametrize("count", [2, 5, 6, 7, 20])
@pytest.mark.parametrize("dtype", DTYPES)
def test_copies_of_a_source_show_what_it_shows(op, count, dtype):
    source = camera((0.3, 0.1, 0), yaw=0.02)
    one, many = [run(op, problem(NEW, [source] * n, [noise(source, 0)] * n, dtype=dtype)) for n in (1, count)]
    atol = 1e-5 if dtype == torch.float32 else 1e-12
    torch.testing.assert_close(many[0].colour, one[0].colour, rtol=0, atol=atol)
    torch.testing.assert_close(many[0].weight, one[0].weight, rtol=0, atol=atol)
    assert many[0].variance.max() < 1e-9
    assert all(grad.isfinite().all() for grad in many[1])
    seen = one[0].weight > 0
    torch.testing.assert_close(many[0].weights[: min(5, count), seen].sum(0), one[0].weights[0, seen])


@OPS
@pytest.mark.parametrize("gradients", [False, True])
def test_what_is_not_asked_for_is_empty_and_changes_nothing(op, gradients):
    depth, *rest = problem(NEW, random_sources(5, 8))
    depth.requires_grad_(gradients)
    whole, part = op(depth, *rest, keep=3, each=True), op(depth, *rest, keep=3)
    assert (whole.sources >= 0).any()
    assert (part.weights.shape, part.shown.shape) == ((0, 14, 20), (0, 3, 14, 20))
    assert part.sources.shape == (14, 20, 4 if gradients else 0)
    for a, b in zip(part[:3], whole[:3], strict=True):
        assert torch.equal(a, b)
    with torch.no_grad():
        assert op(depth, *rest).sources.shape == (14, 20, 0)


@OPS
def test_equal_scores_go_by_index(op):
    # The best of all comes last and moves the others down.
    aside = camera((0.5, 0.1, 0))
    blend = op(*problem(NEW, [aside, aside, aside, NEW]), keep=2, each=True)
    all_seen = (blend.sources >= 0).all(-1)
    assert all_seen.sum() > 20
    assert (blend.sources[all_seen] == torch.tensor([3, 0, 1])).all()


@pytest.mark.parametrize("keep", [1, 3])
def test_the_order_of_sources_does_not_matter(keep):
    depth, warps, K, focal, photos, depths = problem(NEW, random_sources(5, 8))
    expected = blend_photos(depth, warps, K, focal, photos, depths, keep=keep, border=2.0, each=True)
    order = torch.tensor([3, 0, 7, 5, 1, 6, 2, 4])
    blend = blend_photos(
        depth,
        warps[order],
        K[order],
        focal,
        [photos[i] for i in order],
        [depths[i] for i in order],
        keep=keep,
        border=2.0,
        each=True,
    )
    for a, b in zip(blend[:3], expected[:3], strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-12)
    theirs = torch.where(blend.sources >= 0, order[blend.sources.clamp(min=0).long()], -1)
    assert torch.equal(theirs, expected.sources.long())


def test_views_that_are_not_contiguous_are_taken_as_they_are():
    depth, warps, K, focal, photos, depths = problem(NEW, random_sources(5, 4))
    expected = blend_photos(depth, warps, K, focal, photos, depths, each=True)

    def strided(x: Tensor) -> Tensor:
        return x.transpose(0, 1).contiguous().transpose(0, 1)

    blend = blend_photos(
        strided(depth),
        strided(warps),
        strided(K),
        focal,
        [strided(photo) for photo in photos],
        [strided(d) for d in depths],
        each=True,
    )
    for a, b in zip(blend, expected, strict=True):
        assert torch.equal(a, b)


def test_a_strip_as_long_as_16_bits_count():
    # Row and photograph: each pixel shows its own texel.
    length = 65536
    K = torch.eye(3, dtype=torch.float64)[None]
    warps = torch.eye(3, 4, dtype=torch.float64)[None]
    depth = torch.ones(1, length, dtype=torch.float64)
    photo = torch.arange(3.0 * length, dtype=torch.float64).reshape(1, length, 3)
    chain = mip_chain(photo)
    assert chain.shape == (2 * length - 1, 4)
    blend, grads = run(blend_photos, [depth, warps, K, 1.0, [chain], [depth]], angle=9.0)
    torch.testing.assert_close(blend.colour[:, 0], photo[0].T, rtol=1e-9, atol=1e-6)
    twin = reference.blend_photos(depth, warps, K, 1.0, [chain], [depth], angle=9.0, each=True)
    for a, b in zip(blend, twin, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-6)
    assert grads[2][:length, :3].abs().min() > 0
    column = run(
        blend_photos,
        [depth.T, warps, K, 1.0, [chain], [depth.T]],
        angle=9.0,
    )[0]
    torch.testing.assert_close(column.weight.T, blend.weight)


def levels(chain: Tensor, height: int, width: int) -> list[Tensor]:
    found, chain = [], chain[:, :3]
    while True:
        found.append(chain[: height * width].reshape(height, width, 3))
        chain = chain[height * width :]
        if height == width == 1:
            assert len(chain) == 0
            return found
        height, width = (height + 1) // 2, (width + 1) // 2


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32, torch.float64])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 2), (2, 1), (1, 7), (5, 3), (8, 8), (9, 16)])
def test_mip_chains_halve_down_to_one_texel(dtype, height, width):
    image = 255 * torch.rand(height, width, 3, generator=torch.Generator().manual_seed(0))
    image = image.to(dtype)
    chain = mip_chain(image)
    assert chain.dtype == dtype
    first, *coarse = levels(chain, height, width)
    assert torch.equal(first, image)
    fine = image.double()
    for level in coarse:
        for y, x in np.ndindex(*level.shape[:2]):
            mean = fine[2 * y : 2 * y + 2, 2 * x : 2 * x + 2].mean((0, 1))
            # Bytes are rounded once a level.
            atol = {torch.uint8: 1.01, torch.float32: 1e-4, torch.float64: 1e-10}[dtype]
            torch.testing.assert_close(level[y, x].double(), mean, rtol=0, atol=atol)
        fine = level.double()


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float64])
@pytest.mark.parametrize("hidden", [200.0, torch.nan])
def test_masked_pixels_do_not_leak_into_coarse_levels(dtype, hidden):
    if dtype == torch.uint8 and hidden != hidden:
        return
    mask = torch.rand(9, 13, generator=torch.Generator().manual_seed(0)) < 0.3
    mask[4:, :8] = False
    image = torch.where(mask[..., None], 40.0, hidden).expand(-1, -1, 3).to(dtype)
    counts = mask
    for level in levels(mip_chain(image, mask), 9, 13)[1:]:
        counts = torch.nn.functional.max_pool2d(counts[None, None].double(), 2, ceil_mode=True)[0, 0] > 0
        assert (level[counts] == 40).all()
    assert (mip_chain(image, torch.ones_like(mask))[: 9 * 13, :3] == image.reshape(-1, 3)).any()


def test_masks_of_nothing_and_of_everything():
    image = torch.rand(6, 7, 3, dtype=torch.float64)
    plain = mip_chain(image)
    for mask in (torch.ones(6, 7, dtype=torch.bool), torch.zeros(6, 7, dtype=torch.bool)):
        torch.testing.assert_close(mip_chain(image, mask)[: 6 * 7 + 3 * 4], plain[: 6 * 7 + 3 * 4])


def test_mip_chains_are_differentiable():
    image = torch.rand(3, 5, 3, dtype=torch.float64, requires_grad=True)
    mask = torch.tensor([[1, 0, 1, 1, 0], [0, 0, 1, 1, 0], [0, 0, 0, 1, 1]], dtype=torch.bool)
    assert torch.autograd.gradcheck(lambda x: mip_chain(x, mask), image)
