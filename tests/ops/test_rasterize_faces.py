from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.ops import rasterize_faces, rasterize_faces_pyramid, reference

DTYPES = (torch.float32, torch.float64)


def int32(rows) -> Tensor:
    return torch.tensor(rows, dtype=torch.int32).reshape(-1, 3)


def flat(uv, z: float = 1.0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Homogeneous pixels of image points at one depth."""
    uv = torch.as_tensor(uv, dtype=dtype)
    return torch.cat([uv * z, torch.full_like(uv[:, :1], z)], 1)


def look(rotation=None, width=48, height=32, focal=30.0, t=(0.0, 0.0, 0.0)) -> Camera:
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(K, np.eye(3) if rotation is None else rotation, np.array(t), width, height)


def random_rotation(seed: int):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("seed", range(8))
def test_agrees_with_the_twin(assert_same, random_scene, dtype, seed):
    h, faces = random_scene(seed, 37, 53, dtype=dtype)
    assert_same(rasterize_faces, reference.rasterize_faces, [h, faces, 37, 53])


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("height", "width", "levels"), [(37, 53, 4), (16, 32, 5), (5, 2, 9)])
def test_a_pyramid_agrees_with_its_levels_and_with_the_twin(
    assert_same, random_scene, dtype, height, width, levels
):
    h, faces = random_scene(levels, height, width, dtype=dtype)

    def flat_parts(op):
        def parts(h: Tensor, faces: Tensor) -> tuple[Tensor, ...]:
            return tuple(part for hits in op(h, faces, height, width, levels) for part in hits)

        return parts

    assert_same(
        flat_parts(rasterize_faces_pyramid), flat_parts(reference.rasterize_faces_pyramid), [h, faces]
    )
    for k, hits in enumerate(rasterize_faces_pyramid(h, faces, height, width, levels)):
        halved = h * h.new_tensor([0.5**k, 0.5**k, 1])
        alone = rasterize_faces(halved, faces, -(-height // 2**k), -(-width // 2**k))
        for part, whole in zip(hits, alone, strict=True):
            assert torch.equal(part, whole)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("count", [1, 7, 513, 20000])
@pytest.mark.parametrize("largest", [0.6, 3.0, 40.0])
def test_agrees_with_the_twin_whatever_the_size_and_number_of_faces(assert_same, dtype, count, largest):
    # Each path of the kernel: less and more than a vector or a block of faces, none to many pixels each.
    g = np.random.default_rng(count)
    height, width = 40, 70
    centre = g.uniform(-5, (width + 5, height + 5), (count, 1, 2))
    # Never slivers, whose gradients are all rounding.
    around = g.uniform(0, 7, (count, 1)) + 2 * np.pi / 3 * np.arange(3) + g.uniform(-0.5, 0.5, (count, 3))
    uv = centre + largest / 2 * np.stack([np.cos(around), np.sin(around)], 2)
    z = g.uniform(1, 2, (count, 3, 1))
    h = torch.tensor(np.concatenate([uv * z, z], 2).reshape(-1, 3)).to(dtype)
    faces = torch.arange(3 * count, dtype=torch.int32).reshape(-1, 3)
    assert_same(rasterize_faces, reference.rasterize_faces, [h, faces, height, width])


def test_gradient_is_the_derivative(random_scene):
    h, faces = random_scene(3, 5, 6, vertices=9, faces=6)
    assert (rasterize_faces(h, faces, 5, 6)[0] >= 0).sum() > 5

    def values(h: Tensor) -> tuple[Tensor, ...]:
        return tuple(x for hits in rasterize_faces_pyramid(h, faces, 5, 6, 2) for x in hits[1:])

    assert torch.autograd.gradcheck(values, h.requires_grad_(), eps=1e-8, atol=1e-4)


def test_barycentrics_and_depth_are_perspective_correct():
    camera = look()
    vertices = torch.tensor([[-3.0, -2, 2], [4, -1, 7], [0.5, 3, 4]], dtype=torch.float64)
    h = camera.project(vertices).requires_grad_()
    faces = int32([0, 1, 2])
    face, bary, depth = rasterize_faces(h, faces, camera.height, camera.width)
    seen = face == 0
    assert seen.sum() > 50
    hits = bary[seen] @ vertices
    rays = camera.rays(torch.float64)[seen]
    torch.testing.assert_close(torch.nn.functional.normalize(hits, dim=-1), rays)
    torch.testing.assert_close(depth[seen], hits[:, 2])
    assert (depth[~seen] == 0).all()

    def depth_of(h: Tensor) -> Tensor:
        return rasterize_faces(h, faces, 8, 12).depth

    # Moved, so that no pixel centre is on an edge, where the depth jumps.
    small = camera.resized(12, 8).cropped(0.13, 0.21, 12, 8).project(vertices).requires_grad_()
    assert torch.autograd.gradcheck(depth_of, small)


@pytest.mark.parametrize("op", [rasterize_faces, reference.rasterize_faces])
def test_a_pixel_belongs_to_the_triangle_that_holds_its_centre(op):
    # Strictly inside: the centre (2.5, 1.5), that is column 2 of row 1, and no other.
    face, bary, _ = op(flat([[2.2, 1.2], [3.2, 1.4], [2.3, 2.1]]), int32([0, 1, 2]), 4, 5)
    assert (face >= 0).nonzero().tolist() == [[1, 2]]
    corners = bary[1, 2] @ torch.tensor([[2.2, 1.2], [3.2, 1.4], [2.3, 2.1]], dtype=torch.float64)
    torch.testing.assert_close(corners, torch.tensor([2.5, 1.5], dtype=torch.float64))


def grid_mesh(seed: int, columns: int, rows: int, on_centres: bool) -> tuple[Tensor, Tensor]:
    """A triangulated grid, its diagonals and windings at random."""
    g = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    uv = np.stack([x, y], -1).reshape(-1, 2) + 0.5
    if not on_centres:
        uv += g.uniform(-0.3, 0.3, uv.shape)
    faces = []
    for j in range(rows):
        for i in range(columns):
            a, b = j * (columns + 1) + i, j * (columns + 1) + i + 1
            c, d = a + columns + 1, b + columns + 1
            pair = [[a, b, d], [a, d, c]] if g.random() < 0.5 else [[a, b, c], [b, d, c]]
            faces += [face[:: g.choice([-1, 1])] for face in pair]
    return torch.tensor(uv), int32(faces)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("on_centres", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_pixels_on_edges_and_vertices_belong_to_exactly_one_face(dtype, on_centres, seed):
    uv, faces = grid_mesh(seed, 9, 7, on_centres)
    depth = torch.tensor(np.random.default_rng(seed).uniform(1, 3, (len(uv), 1)))
    if on_centres and seed == 0:
        depth = torch.ones_like(depth)
    elif on_centres:
        depth = 2.0 ** (depth * 2).floor()  # products stay exact
    h = torch.cat([uv * depth, depth], 1).to(dtype)
    owners = sum((rasterize_faces(h, f[None], 8, 10)[0] == 0).int() for f in faces)
    assert owners.max() == 1
    assert (owners[1:7, 1:9] == 1).all()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("seed", range(5))
def test_pixels_within_rounding_of_an_edge_belong_to_exactly_one_face(dtype, seed):
    # Vertices that rounding moves a little off every second pixel centre: edges then pass the centres between
    # them at a distance that is all rounding, where only exactly opposite edge functions agree.
    uv, faces = grid_mesh(seed, 9, 7, on_centres=True)
    uv = 2 * uv - 0.5
    depth = torch.tensor(np.random.default_rng(seed).uniform(1, 3, (len(uv), 1)))
    h = torch.cat([uv * depth, depth], 1).to(dtype)
    owners = sum((rasterize_faces(h, f[None], 15, 19)[0] == 0).int() for f in faces)[1:-1, 1:-1]
    at_vertices = torch.zeros_like(owners, dtype=torch.bool)
    at_vertices[1::2, 1::2] = True
    assert (owners[~at_vertices] == 1).all()


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), subdivisions=st.integers(0, 3), jitter=st.floats(0, 0.3))
def test_a_closed_mesh_seen_from_inside_leaves_no_empty_pixel(seed, subdivisions, jitter):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    g = np.random.default_rng(seed)
    vertices = ball.vertices * (1 + jitter * g.uniform(-1, 1, (len(ball.vertices), 1)))
    camera = look(random_rotation(seed), width=40, height=30, focal=g.uniform(3, 60))
    h = camera.project(torch.tensor(vertices, dtype=torch.float32))
    face, _, _ = rasterize_faces(h, torch.tensor(ball.faces.astype(np.int32)), 30, 40)
    assert (face >= 0).all()


@pytest.mark.parametrize("op", [rasterize_faces, reference.rasterize_faces])
@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_the_ground_under_the_camera_fills_the_image_below_the_horizon(op, tilt):
    rotation = np.array(
        [[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]
    )
    camera = look(rotation)
    ground = torch.tensor([[-1e4, 1.5, -1e4], [1e4, 1.5, -1e4], [1e4, 1.5, 1e4], [-1e4, 1.5, 1e4]])
    face, bary, depth = op(camera.project(ground), int32([[0, 1, 2], [0, 2, 3]]), camera.height, camera.width)
    down = camera.rays()[..., 1]
    assert (face[down > 1e-3] >= 0).all()
    assert (face[down < 0] == -1).all()
    assert bary.isfinite().all()
    assert bary.min() >= 0
    assert depth[face >= 0].min() > 0


def test_nearest_wins_and_ties_go_to_the_lower_index():
    square = [[1, 1], [9, 1], [9, 9], [1, 9]]
    h = torch.cat([flat(square, 2.0), flat(square, 1.0), flat(square, 1.0), flat(square, 3.0)])
    faces = int32([[4 * k + a, 4 * k + b, 4 * k + c] for k in range(4) for a, b, c in ((0, 1, 2), (0, 2, 3))])
    face, _, _ = rasterize_faces(h, faces, 10, 10)
    assert set(face.unique().tolist()) == {-1, 2, 3}
    order = torch.tensor([0, 1, 4, 5, 2, 3, 6, 7])  # the two equal ones swapped
    swapped, _, _ = rasterize_faces(h, faces[order], 10, 10)
    assert torch.equal(swapped, face)


def test_both_sides_of_a_face_are_drawn():
    h = flat([[1, 1], [9, 2], [4, 8]])
    one, _, _ = rasterize_faces(h, int32([0, 1, 2]), 10, 10)
    other, _, _ = rasterize_faces(h, int32([0, 2, 1]), 10, 10)
    assert (one == 0).sum() > 10
    assert torch.equal(one, other)


@pytest.mark.parametrize("op", [rasterize_faces, reference.rasterize_faces])
@pytest.mark.parametrize("dtype", DTYPES)
def test_what_cannot_be_drawn_is_left_out(op, dtype):
    h = flat([[1, 1], [9, 2], [4, 8]], dtype=dtype)
    good = int32([0, 1, 2])
    expected, _, _ = op(h, good, 10, 10)
    bad = torch.tensor([math.nan, math.inf, -math.inf], dtype=dtype)
    broken = torch.cat([h, h[:1] * 2, torch.diag(bad) + 1, -h])
    broken[4:7][torch.eye(3) == 0] = 1
    # Repeated vertices, collinear in space through the camera, not finite, behind the camera.
    faces = int32([[0, 0, 1], [1, 1, 1], [0, 3, 1], [0, 1, 4], [0, 5, 2], [6, 1, 2], [7, 8, 9]])
    assert (op(broken, faces, 10, 10)[0] == -1).all()
    face, bary, depth = op(broken, torch.cat([good, faces]), 10, 10)
    assert torch.equal(face, expected)
    assert bary.isfinite().all()
    assert depth.isfinite().all()


def sheets(seed: int, layers: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Grids of small faces that cross, many at the same depth, one with holes; and thin faces edge-on."""
    g = np.random.default_rng(seed)
    u, v = np.meshgrid(np.linspace(-2.013, 66.17, 41), np.linspace(-2.019, 50.23, 31))
    corner = np.arange(40) + 41 * np.arange(30)[:, None]
    halves = np.stack([[corner, corner + 1, corner + 42], [corner, corner + 42, corner + 41]])
    quads = halves.transpose(2, 3, 0, 1)
    h, faces = [], []
    for layer in range(layers):
        z = 1 + 0.1 * np.sin(u / 6 + layer // 2) + 0.1 * np.sin(v / 5)
        if layer % 3:
            z = np.round(16 * z) / 16
        kept = quads.reshape(-1, 3)[g.random(2400) > 0.15 * (layer == 0)]
        faces.append(kept + sum(map(len, h)))
        h.append(np.stack([u * z, v * z, z], -1).reshape(-1, 3))
    # Corners in one line with the camera, but for as much as float keeps of it.
    ends = g.uniform(0, 48, (300, 2, 2))
    third = ends.mean(1) + g.choice([0, 1e-6, 1e-3], (300, 1))
    uv, z = np.concatenate([ends, third[:, None]], 1), g.uniform(0.3, 6, (300, 3, 1))
    faces.append(np.arange(900).reshape(-1, 3) + sum(map(len, h)))
    h.append(np.concatenate([uv * z, z], -1).reshape(-1, 3))
    return torch.tensor(np.concatenate(h)).to(dtype), torch.tensor(np.concatenate(faces).astype(np.int32))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("order", ["along the grids", "any"])
@pytest.mark.parametrize("layers", [1, 2, 7])
def test_what_is_left_out_as_hidden_would_not_be_seen(dtype, order, layers):
    h, faces = sheets(layers, layers, dtype)
    h[5::297], h[6::297, 2], h[7::297, 0], h[8::297, 2], h[9::297, 2] = (
        math.nan,
        -1,
        math.inf,
        math.inf,
        1e-40,
    )
    if order == "any":
        faces = faces[torch.randperm(len(faces), generator=torch.Generator().manual_seed(0))]
    found = rasterize_faces_pyramid(h, faces, 48, 64, 3)
    expected = reference.rasterize_faces_pyramid(h, faces, 48, 64, 3)
    assert len(expected[0].face.unique()) > 500
    for ours, theirs in zip(found, expected, strict=True):
        assert torch.equal(ours.face, theirs.face)
        torch.testing.assert_close(ours.depth, theirs.depth)


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_corner_as_good_as_on_the_camera_plane_hides_no_pixel(dtype):
    # Above the image, below the left and the right edge; z so small that its reciprocal is infinite in float.
    h = torch.tensor([[0, 0, 1e-40], [-20, 40, 1], [60, 40, 1]], dtype=dtype)
    found = rasterize_faces(h, int32([0, 1, 2]), 32, 40)
    expected = reference.rasterize_faces(h, int32([0, 1, 2]), 32, 40)
    assert (expected.face == 0).sum() > 100
    assert torch.equal(found.face, expected.face)


def test_empty_inputs():
    none = torch.zeros(0, 3)
    for faces, h in ((int32([]), none), (int32([]), torch.ones(4, 3))):
        for op in (rasterize_faces, reference.rasterize_faces):
            face, bary, depth = op(h.requires_grad_(), faces, 3, 4)
            assert face.shape == (3, 4)
            assert (face == -1).all()
            assert (bary == 0).all()
            assert (depth == 0).all()
        (bary.sum() + depth.sum()).backward()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 65536), (65536, 1), (3, 2000), (17, 33)])
def test_images_of_any_shape(height, width):
    corners = flat([[-1, -1], [2 * width + 2, -1], [-1, 2 * height + 2]], dtype=torch.float32)
    face, bary, _ = rasterize_faces(corners, int32([0, 1, 2]), height, width)
    assert (face == 0).all()
    x = bary @ corners[:, :1]
    torch.testing.assert_close(
        x[..., 0], (torch.arange(width) + 0.5).expand(height, width), rtol=1e-5, atol=1e-4
    )


def test_views_that_are_not_contiguous_are_taken_as_they_are(random_scene):
    h, faces = random_scene(0, 20, 30)
    expected = rasterize_faces(h, faces, 20, 30)
    found = rasterize_faces(h.T.contiguous().T, faces.T.contiguous().T, 20, 30)
    for part, whole in zip(found, expected, strict=True):
        assert torch.equal(part, whole)


def test_agrees_with_an_independent_ray_caster():
    ball = trimesh.creation.icosphere(subdivisions=7)  # 327,680 faces
    g = np.random.default_rng(0)
    vertices = ball.vertices * (1 + 0.002 * g.uniform(-1, 1, (len(ball.vertices), 1)))
    mesh = trimesh.Trimesh(vertices, ball.faces, process=False)
    caster = trimesh.ray.ray_pyembree.RayMeshIntersector(mesh)
    camera = look(random_rotation(1), width=200, height=150, focal=140.0, t=(0.1, -0.2, 2.5))
    h = camera.project(torch.tensor(vertices))
    face, _, _ = rasterize_faces(h, torch.tensor(ball.faces.astype(np.int32)), camera.height, camera.width)
    rays = camera.rays(torch.float64).reshape(-1, 3).numpy()
    hit = caster.intersects_first(np.broadcast_to(camera.centre, rays.shape), rays)
    assert (hit >= 0).mean() > 0.2
    assert (face.flatten().numpy() == hit).mean() >= 0.9999
