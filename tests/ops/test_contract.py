"""What all ops promise: torch.library's rules, equal bits for any number of threads, errors for bad input."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from nmbg import _core
from nmbg.ops import (
    blend_photos,
    mip_chain,
    rasterize_faces,
    rasterize_faces_pyramid,
    rasterize_points,
    rasterize_points_pyramid,
    reference,
    shade_faces,
    shade_points,
)

H, W = 90, 120


def blending(sources: int, height: int, width: int, dtype: torch.dtype):
    """Arguments of blend_photos(): cameras side by side in front of an uneven wall, and their photographs."""
    g = torch.Generator().manual_seed(2)

    def image(*shape: int):
        return torch.rand(*shape, generator=g, dtype=torch.float64).to(dtype)

    focal = float(width)
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=dtype)
    aside = (image(sources, 3) - 0.5) * torch.tensor([0.6, 0.4, 0.4], dtype=dtype)
    warps = torch.cat([K.double().inverse().to(dtype).expand(sources, 3, 3), aside[:, :, None]], 2)
    zooms = torch.tensor([1.0, 0.7, 2.5], dtype=dtype)[torch.arange(sources) % 3]
    sizes = [(int(height * zoom), int(width * zoom)) for zoom in zooms.tolist()]
    K = torch.stack([torch.diag(torch.stack([z, z, torch.ones_like(z)])) @ K for z in zooms])
    photos = [mip_chain(image(*size, 3)) for size in sizes]
    return (
        image(height, width) * 0.05 + 2,
        warps,
        K,
        focal,
        photos,
        [image(*size) * 0.3 + 1.85 for size in sizes],
    )


def blend_all(depth, warps, K, focal, depths, *photos):
    return blend_photos(depth, warps, K, focal, photos, depths, keep=3, border=4.0, each=True)[:4]


@pytest.fixture
def scene(random_scene, unit_rays):
    h, faces = random_scene(0, H, W, vertices=9000, faces=9000, dtype=torch.float32)
    index, dist2 = rasterize_points(h, 1.63, H, W)
    face, bary, _ = rasterize_faces(h, faces, H, W)
    coeffs = torch.randn(9000, 9, 8, generator=torch.Generator().manual_seed(1))
    rays = unit_rays(1, H, W, torch.float32)
    *wall, photos, photo_depths = blending(7, H, W, torch.float32)
    bytes_of = [(255 * photo).byte() for photo in photos]
    return {
        "rasterize_points": (rasterize_points, [h, 1.63, H, W]),
        "rasterize_faces": (rasterize_faces, [h, faces, H, W]),
        "shade_points": (
            shade_points,
            [index, 1 - dist2 / 1.63**2, rays, coeffs],
        ),
        "shade_faces": (shade_faces, [face, bary, faces, rays, coeffs]),
        # Most pixels end in a few vertices: sums that another order would round differently.
        "shade_crowded": (
            shade_faces,
            [face.clamp(max=3), bary, faces % 5, rays, coeffs],
        ),
        "blend_photos": (blend_all, [*wall, photo_depths, *photos]),
        "blend_bytes": (blend_all, [*wall, photo_depths, *bytes_of]),
    }


@pytest.mark.parametrize(
    "name",
    [
        "rasterize_points",
        "rasterize_faces",
        "shade_points",
        "shade_faces",
        "shade_crowded",
        "blend_photos",
        "blend_bytes",
    ],
)
def test_same_bits_for_any_number_of_threads(scene, run_op, each_thread_count, name):
    op, inputs = scene[name]
    first, *others = each_thread_count(lambda: [x for group in run_op(op, inputs) for x in group])
    assert any(x.numel() for x in first)
    for _ in range(3):
        for other in others:
            for a, b in zip(first, other, strict=True):
                assert torch.equal(a, b)
        others = each_thread_count(lambda: [x for group in run_op(op, inputs) for x in group])


def test_torch_library_contract(random_scene, unit_rays):
    h, faces = random_scene(0, 7, 9)
    index, dist2 = rasterize_points(h, 1.0, 7, 9)
    face, bary, depth_seen = rasterize_faces(h, faces, 7, 9)
    rays = unit_rays(0, 7, 9).requires_grad_()
    coeffs = torch.randn(60, 4, 3, dtype=torch.float64, requires_grad=True)
    grad = torch.randn(3, 7, 9, dtype=torch.float64)
    grad_h = h.clone().requires_grad_()
    points = (index, dist2[..., None].clone().requires_grad_(), None, rays, coeffs)
    corners = (face, bary.clone().requires_grad_(), faces, rays, coeffs)
    detached = [tuple(x if x is None else x.detach() for x in args) for args in (points, corners)]
    ops = torch.ops.nmbg
    depth, warps, K, focal, photos, depths = blending(3, 5, 6, torch.float64)
    rule = (2, 0.1, 0.05, 2.0)
    bytes_of = [(255 * photo).byte() for photo in photos]
    wanted = [x.clone().requires_grad_() for x in (depth, warps, *photos)]
    sources = blend_photos(depth, warps, K, focal, photos, depths, *rule, each=True).sources
    assert (sources >= 0).all(-1).any()
    to_pixels = (grad[:, :5, :6].contiguous(), grad[0, :5, :6].contiguous(), grad[1, :5, :6].contiguous())
    down = (*to_pixels, sources, depth, warps, K)
    calls = [
        (ops.rasterize_points, (grad_h, 1.0, 7, 9, 1)),
        (ops.rasterize_points, (grad_h, 1.0, 7, 9, 3)),
        (ops.rasterize_points_backward, (h, 1.0, 7, 9, 1, index.flatten(), dist2.flatten())),
        (ops.rasterize_faces, (grad_h, faces, 7, 9, 1)),
        (ops.rasterize_faces, (grad_h, faces, 7, 9, 3)),
        (
            ops.rasterize_faces_backward,
            (h, faces, 7, 9, 1, face.flatten(), bary.reshape(-1, 3), depth_seen.flatten()),
        ),
        (ops.shade, points),
        (ops.shade, corners),
        *[(ops.shade_backward_coeffs, (grad, *args)) for args in detached],
        *[(ops.shade_backward_pixels, (grad, *args)) for args in detached],
        *[
            (ops.blend_photos, (*wanted[:2], K, wanted[2:], depths, focal, *rule, each, True))
            for each in (False, True)
        ],
        (ops.blend_photos, (*wanted[:2], K, bytes_of, depths, focal, *rule, True, True)),
        (ops.blend_photos, (wanted[0], warps[:0], K[:0], [], [], focal, *rule, True, True)),
        (ops.blend_photos_backward, (*down, photos, depths, focal, *rule)),
        (ops.blend_photos_backward, (*down, bytes_of, depths, focal, *rule)),
        (ops.blend_photos_backward_texels, (*down, photos, depths, focal, *rule)),
    ]
    for op, arguments in calls:
        torch.library.opcheck(op.default, arguments)


def test_indices_are_not_differentiable(random_scene):
    h, faces = random_scene(0, 7, 9)
    h.requires_grad_()
    for index, *values in (rasterize_points(h, 1.0, 7, 9), rasterize_faces(h, faces, 7, 9)):
        assert not index.requires_grad
        assert all(value.requires_grad for value in values)
    depth, *rest = blending(2, 5, 6, torch.float64)
    blend = blend_photos(depth.requires_grad_(), *rest, each=True)
    assert [x.requires_grad for x in blend] == [True, True, True, False, False, False]


def int32(*rows):
    return torch.tensor(rows, dtype=torch.int32)


CORNERS = torch.tensor([[1.0, 1, 1], [5, 1, 1], [1, 5, 1]])
TRIANGLE = int32([0, 1, 2])
RAYS = torch.ones(2, 2, 3)
BARY = torch.ones(2, 2, 3)
NONE = torch.full((2, 2), -1, dtype=torch.int32)
ONE = torch.zeros((2, 2), dtype=torch.int32)
COEFFS = torch.ones(3, 4, 2)


def blend(index: int | None = None, value=None, **options):
    """A call of blend_photos() with one argument of another kind."""
    arguments = [
        torch.ones(2, 2),
        torch.eye(3, 4).expand(2, 3, 4),
        torch.eye(3).expand(2, 3, 3),
        1.0,
        [torch.ones(6 + 2 + 1, 4)] * 2,
        [torch.ones(2, 3)] * 2,
    ]
    if index is not None:
        arguments[index] = value(arguments[index])
    return lambda: blend_photos(*arguments, **options)


BAD = {
    "face vertex above": (
        lambda: rasterize_faces(CORNERS, int32([0, 1, 3]), 4, 4),
        "faces: .* 0 to 2, got 3",
    ),
    "face vertex below": (lambda: rasterize_faces(CORNERS, int32([0, -1, 2]), 4, 4), "faces: .*got -1"),
    "faces without vertices": (lambda: rasterize_faces(CORNERS[:0], TRIANGLE, 4, 4), "faces: .*got 0"),
    "faces of int64": (lambda: rasterize_faces(CORNERS, TRIANGLE.long(), 4, 4), "faces: .*int32.*int64"),
    "faces of 4": (lambda: rasterize_faces(CORNERS, int32([0, 1, 2, 0]), 4, 4), r"faces: .*\[1, 4\]"),
    "h of half": (lambda: rasterize_faces(CORNERS.half(), TRIANGLE, 4, 4), "h: .*float16"),
    "h of int": (lambda: rasterize_points(CORNERS.int(), 1.0, 4, 4), "h: .*int32"),
    "h of 2 columns": (lambda: rasterize_points(CORNERS[:, :2], 1.0, 4, 4), r"h: .*\[3, 2\]"),
    "h of one axis": (lambda: rasterize_points(CORNERS[0], 1.0, 4, 4), r"h: .*\[3\]"),
    "no rows": (lambda: rasterize_points(CORNERS, 1.0, 0, 4), "height 0"),
    "no level": (lambda: rasterize_faces_pyramid(CORNERS, TRIANGLE, 4, 4, 0), "levels: .*got 0"),
    "negative width": (lambda: rasterize_faces(CORNERS, TRIANGLE, 4, -4), "width -4"),
    "huge image": (lambda: rasterize_faces(CORNERS, TRIANGLE, 2**16, 2**16), "height 65536 and width 65536"),
    "radius zero": (lambda: rasterize_points(CORNERS, 0.0, 4, 4), "radius_px: .*0.0"),
    "radius nan": (lambda: rasterize_points(CORNERS, float("nan"), 4, 4), "radius_px: .*nan"),
    "point above": (lambda: shade_points(ONE + 3, BARY[..., 0], RAYS, COEFFS), "index: .*-1 to 2, got 3"),
    "point below": (lambda: shade_points(ONE - 2, BARY[..., 0], RAYS, COEFFS), "index: .*got -2"),
    "face above": (lambda: shade_faces(ONE + 1, BARY, TRIANGLE, RAYS, COEFFS), "index: .*-1 to 0, got 1"),
    "corner above": (lambda: shade_faces(ONE, BARY, TRIANGLE + 1, RAYS, COEFFS), "faces: .*got 3"),
    "rays of double": (lambda: shade_faces(ONE, BARY, TRIANGLE, RAYS.double(), COEFFS), "rays: .*float32"),
    "rays of another size": (
        lambda: shade_faces(ONE, BARY, TRIANGLE, RAYS[:1], COEFFS),
        r"rays: .*\[1, 2, 3\]",
    ),
    "two weights": (
        lambda: shade_faces(ONE, BARY[..., :2], TRIANGLE, RAYS, COEFFS),
        r"weight: .*\[2, 2, 2\]",
    ),
    "view of half": (blend(0, torch.Tensor.half), "depth: .*float16"),
    "view of bytes": (blend(0, torch.Tensor.byte), "depth: .*uint8"),
    "view of one axis": (blend(0, torch.Tensor.flatten), r"depth: .*\[4\]"),
    "view without rows": (blend(0, lambda x: x[:0]), "height 0"),
    "view of double": (blend(0, torch.Tensor.double), "warps: .*float64.*float32"),
    "warps of double": (blend(1, torch.Tensor.double), "warps: .*float32.*float64"),
    "one warp too few": (blend(1, lambda x: x[:1]), r"warps: .*\[2, 3, 4\].*\[1, 3, 4\]"),
    "warps of 3 × 3": (blend(1, lambda x: x[:, :, :3]), r"warps: .*\[2, 3, 3\]"),
    "intrinsics of double": (blend(2, torch.Tensor.double), "intrinsics: .*float32.*float64"),
    "one camera too many": (blend(2, lambda x: x[[0, 1, 0]]), r"intrinsics: .*\[3, 3, 3\]"),
    "focal zero": (blend(3, lambda _: 0.0), "focal: .*0.0"),
    "focal nan": (blend(3, lambda _: float("nan")), "focal: .*nan"),
    "photo of double": (blend(4, lambda x: [x[0].double(), x[1]]), "photos: .*float32.*float64"),
    "bytes, then floats": (blend(4, lambda x: [x[0].byte(), x[1]]), "photos: .*uint8.*float32"),
    "floats, then bytes": (blend(4, lambda x: [x[0], x[1].byte()]), "photos: .*float32.*uint8"),
    "photo of 8 texels": (blend(4, lambda x: [x[0], x[1][:8]]), r"photos: .*\[9, 4\].*\[8, 4\]"),
    "photo of 3 channels": (blend(4, lambda x: [x[0], torch.ones(9, 3)]), r"photos: .*\[9, 3\]"),
    "photo as an image": (blend(4, lambda x: [x[0], torch.ones(2, 3, 3)]), r"photos: .*\[2, 3, 3\]"),
    "one depth too few": (blend(5, lambda x: x[:1]), "photo_depths: expected 2, .*got 1"),
    "one depth too many": (blend(5, lambda x: x + x[:1]), "photo_depths: expected 2, .*got 3"),
    "photo depth of double": (blend(5, lambda x: [x[0], x[1].double()]), "photo_depths: .*float64"),
    "photo depth of 3 axes": (blend(5, lambda x: [x[0], x[1][None]]), r"photo_depths: .*\[1, 2, 3\]"),
    "photo depth of no rows": (blend(5, lambda x: [x[0], x[1][:0]]), "height 0"),
    "keep 0": (blend(keep=0), "keep: expected 1 to 15, got 0"),
    "keep 16": (blend(keep=16), "keep: .*got 16"),
    "angle 0": (blend(angle=0.0), "angle: .*0.0"),
    "angle below 0": (blend(angle=-0.1), "angle: .*-0.1"),
    "tolerance infinite": (blend(tolerance=float("inf")), "tolerance: .*inf"),
    "border nan": (blend(border=float("nan")), "border: .*nan"),
    "5 functions": (lambda: shade_faces(NONE, BARY, TRIANGLE, RAYS, torch.ones(3, 5, 2)), "1, 4 or 9 .*5"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_an_error_that_says_what_came(case):
    call, message = BAD[case]
    with pytest.raises((TypeError, ValueError), match=message):
        call()


def test_backward_checks_indices_too(random_scene):
    h, faces = random_scene(0, 4, 4)
    grad = torch.ones(16, 3, dtype=torch.float64)
    beyond = torch.full((16,), 80, dtype=torch.int32)
    with pytest.raises(ValueError, match=r"face: .*got 80"):
        torch.ops.nmbg.rasterize_faces_backward(h, faces, 4, 4, 1, beyond, grad, grad[:, 0])
    with pytest.raises(ValueError, match=r"face: .*\[21\]"):
        torch.ops.nmbg.rasterize_faces_backward(h, faces, 4, 4, 3, beyond, grad, grad[:, 0])
    with pytest.raises(ValueError, match=r"index: .*got 80"):
        torch.ops.nmbg.rasterize_points_backward(h, 1.0, 4, 4, 1, beyond, grad[:, 0])
    depth, warps, K, focal, photos, depths = blending(2, 4, 4, torch.float64)
    to_colour, to_pixel = torch.ones(3, 4, 4, dtype=torch.float64), torch.ones(4, 4, dtype=torch.float64)
    rest = (depth, warps, K, photos, depths, focal, 2, 0.1, 0.02, 8.0)
    ops = torch.ops.nmbg
    for backward in (ops.blend_photos_backward, ops.blend_photos_backward_texels):
        for index in (2, -2):
            sources = torch.full((4, 4, 3), index, dtype=torch.int32)
            sources[..., 0] = 1
            with pytest.raises(ValueError, match=f"sources: .*-1 to 1, got {index}"):
                backward(to_colour, to_pixel, to_pixel, sources, *rest)
        with pytest.raises(ValueError, match=r"sources: .*\[4, 4, 2\]"):
            backward(to_colour, to_pixel, to_pixel, sources[..., :2], *rest)
        with pytest.raises(ValueError, match=r"grad_weight: .*\[4, 3\]"):
            backward(to_colour, to_pixel[:, :3], to_pixel, sources, *rest)


def test_the_twins_have_the_same_signatures():
    import inspect

    for op in (
        rasterize_points,
        rasterize_points_pyramid,
        rasterize_faces,
        rasterize_faces_pyramid,
        shade_points,
        shade_faces,
        blend_photos,
    ):
        twin = getattr(reference, op.__name__)
        assert inspect.signature(op) == inspect.signature(twin)


def test_threads_must_be_positive():
    with pytest.raises(ValueError, match=r"threads: .*0"):
        _core.rasterize_points(CORNERS.numpy(), 1.0, 2, 2, 1, 0)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.skipif(not _core.openmp, reason="built without OpenMP")
def test_the_process_has_one_openmp_runtime():
    code = (
        "import nmbg.ops, pathlib;"
        "print(len({line.split()[-1] for line in pathlib.Path('/proc/self/maps').read_text().splitlines()"
        " if 'omp' in line.rsplit('/', 1)[-1] and '.so' in line}))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "1"
