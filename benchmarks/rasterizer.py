"""How fast the rasterizers are: beside the loop that one would write first, and what else there is on a CPU.

    python benchmarks/rasterizer.py [--scene out/fox] [--output benchmarks/results]

Faces: a bumpy closed sphere that covers 60 % of the image, and the mesh of a real scene. Points: a bumpy
closed surface and a sparse far background, sorted along a Morton curve and at random. Beside nmbg: a plain
loop (plain_loop.cpp, compiled here), Open3D's ray caster where it is installed, and torch's scatter-min. The
outputs are compared too, but for those of the plain loop on the scene. The compiler is c++, or $CXX.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line does

import click
import numpy as np
import numpy.typing as npt
import torch
from record import command, provenance, write
from timing import alternate, show
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.ops import (
    rasterize_faces,
    rasterize_faces_pyramid,
    rasterize_points,
    rasterize_points_pyramid,
)
from nmbg.scene import Scene

SIZES = ((480, 270), (960, 540), (1920, 1080))
FACES = (200_000, 1_000_000, 2_000_000)
POINTS, BEHIND = 850_000, 150_000
RADIUS = 0.006  # where the short image side spans [−1, 1]
LEVELS = 5
Array = npt.NDArray[np.float64]
Outputs = tuple[Tensor, Tensor]


def bumpy_sphere(faces: int) -> tuple[Array, npt.NDArray[np.int32]]:
    """A cube's grid blown up to an uneven sphere, vertices and faces sorted along a Morton curve."""
    n = int((faces / 12) ** 0.5)
    side = np.tan(np.linspace(-1, 1, n + 1) * np.pi / 4)
    a, b = np.meshgrid(side, side, indexing="ij")
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    corner = (i * (n + 1) + j).ravel()
    vertices, triangles = [], []
    for k, (axis, sign) in enumerate((axis, sign) for axis in range(3) for sign in (-1, 1)):
        vertices.append(np.roll(np.stack([np.full_like(a, sign), a, b], -1), axis, -1).reshape(-1, 3))
        first = corner + k * (n + 1) ** 2
        triangles += [
            np.stack([first, first + 1, first + n + 2], 1),
            np.stack([first, first + n + 2, first + n + 1], 1),
        ]
    v = np.concatenate(vertices)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    v *= 1 + 0.03 * (np.sin(9 * v[:, :1]) * np.sin(8 * v[:, 1:2]) * np.sin(7 * v[:, 2:]))
    order = np.argsort(morton(v))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    f = place[np.concatenate(triangles)]
    return v[order], f[np.argsort(f.min(1), kind="stable")].astype(np.int32)


def morton(points: Array) -> npt.NDArray[np.uint64]:
    """Places along a Morton curve, [N]."""
    low, high = points.min(0), points.max(0)
    cells = ((points - low) / (high - low) * 0xFFFF).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for axis in range(3):
        for bit in range(16):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


def camera_for(width: int, height: int) -> Camera:
    """fx = fy = 0.866 W, at the distance from which a unit sphere covers 60 % of the image."""
    focal = 0.866 * width
    radius = (0.6 * width * height / np.pi) ** 0.5
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(K, np.eye(3), np.array([0, 0, (1 + (focal / radius) ** 2) ** 0.5]), width, height)


class PlainLoop:
    """plain_loop.cpp, compiled with -O3."""

    def __init__(self, folder: Path) -> None:
        library, source = folder / "plain_loop.so", Path(__file__).with_name("plain_loop.cpp")
        compiler = os.environ.get("CXX", "c++")
        options = ["-std=c++20", "-O3", "-fopenmp", "-shared", "-fPIC"]
        subprocess.run([compiler, *options, str(source), "-o", str(library)], check=True)
        self._library = ctypes.CDLL(str(library))

    def faces(self, h: Tensor, faces: Tensor, height: int, width: int) -> Outputs:
        """Face and barycentrics per pixel."""
        face = torch.empty(height, width, dtype=torch.int32)
        depth, bary = torch.empty(height, width), torch.empty(height, width, 3)
        self._library.plain_faces(
            _pointer(h), ctypes.c_int64(len(h)), _pointer(faces), ctypes.c_int64(len(faces)),
            height, width, torch.get_num_threads(), _pointer(face), _pointer(depth), _pointer(bary),
        )  # fmt: skip
        return face, bary

    def points(self, h: Tensor, radius: float, height: int, width: int) -> Outputs:
        """Point and squared distance per pixel."""
        index, dist2 = torch.empty(height, width, dtype=torch.int32), torch.empty(height, width)
        self._library.plain_points(
            _pointer(h), ctypes.c_int64(len(h)), ctypes.c_float(radius),
            height, width, torch.get_num_threads(), _pointer(index), _pointer(dist2),
        )  # fmt: skip
        return index, dist2


def _pointer(tensor: Tensor) -> ctypes.c_void_p:
    return ctypes.c_void_p(tensor.data_ptr())


def open3d_caster(
    vertices: Array, faces: npt.NDArray[np.int32], camera: Camera
) -> Callable[[], Tensor] | None:
    """Open3D's RaycastingScene (Embree), its tree built beforehand; None where it is not installed."""
    try:
        import open3d
    except ImportError:
        return None
    scene = open3d.t.geometry.RaycastingScene(nthreads=torch.get_num_threads())
    tensor = open3d.core.Tensor
    scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))
    origin = np.broadcast_to(camera.centre.astype(np.float32), (camera.height, camera.width, 3))
    rays = tensor(np.concatenate([origin, camera.rays().numpy()], -1))

    def cast() -> Tensor:
        hit = scene.cast_rays(rays)["primitive_ids"].numpy()
        return torch.from_numpy(hit.astype(np.int64))

    return cast


def scatter_points(h: Tensor, radius: float, height: int, width: int) -> Tensor:
    """Point per pixel by torch: a scatter-min of (depth, index) for each offset that a disc may reach."""
    uv, z = h[:, :2] / h[:, 2:], h[:, 2]
    key = (z.view(torch.int32).long() << 32) | torch.arange(len(h))
    best = torch.full((height * width + 1,), torch.iinfo(torch.int64).max)
    corner = (uv - radius - 0.5).ceil()
    reach = int(2 * radius) + 1
    for dy in range(reach):
        for dx in range(reach):
            pixel = corner + torch.tensor([dx, dy])
            near = ((pixel + 0.5 - uv) ** 2).sum(1) < radius * radius
            x, y = pixel.long().unbind(1)
            seen = near & (z > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
            best.scatter_reduce_(0, torch.where(seen, y * width + x, height * width), key, "amin")
    found = best[:-1]
    point = torch.where(found < torch.iinfo(torch.int64).max, found & 0xFFFFFFFF, -1)
    return point.view(height, width)


def _same(a: Tensor, b: Tensor, least: float) -> float:
    share = float((a.long() == b.long()).float().mean())
    assert share >= least, f"outputs agree in {share:.4%} of the pixels only"
    return share


def _threads(call: Callable[[], object]) -> Callable[[], object]:
    """The same on one thread."""

    def alone() -> None:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            call()
        finally:
            torch.set_num_threads(threads)

    return alone


def measure_faces(
    name: str, vertices: Array, faces: npt.NDArray[np.int32], camera: Camera, plain: PlainLoop, repeats: int
) -> dict[str, Any]:
    """One row: this mesh at this size."""
    h = camera.project(torch.from_numpy(vertices.astype(np.float32)))
    f, size = torch.from_numpy(faces), (camera.height, camera.width)
    ours = partial(rasterize_faces, h, f, *size)
    calls: dict[str, Callable[[], object]] = {
        "nmbg": ours,
        "plain": partial(plain.faces, h, f, *size),
        "one thread": _threads(ours),
        "pyramid": partial(rasterize_faces_pyramid, h, f, *size, LEVELS),
    }
    face = ours().face
    row: dict[str, Any] = {"what": name, "count": len(faces), "width": camera.width, "height": camera.height}
    row["covered"] = float((face >= 0).float().mean())
    if name != "scene":  # the plain loop leaves out what crosses the camera plane
        row["same as plain"] = _same(face, plain.faces(h, f, *size)[0], 0.99)
    cast = open3d_caster(vertices, faces, camera)
    if cast is not None:
        hit = cast()
        row["same as Open3D"] = _same(face, torch.where(hit < len(faces), hit, -1), 0.99)
        calls["Open3D"] = cast
    return {**row, "times": alternate(calls, repeats)}


def measure_points(
    order: str, points: Array, camera: Camera, plain: PlainLoop, repeats: int
) -> dict[str, Any]:
    """One row: these points at this size."""
    h = camera.project(torch.from_numpy(points.astype(np.float32)))
    radius, size = RADIUS * camera.height / 2, (camera.height, camera.width)
    ours = partial(rasterize_points, h, radius, *size)
    calls: dict[str, Callable[[], object]] = {
        "nmbg": ours,
        "plain": partial(plain.points, h, radius, *size),
        "one thread": _threads(ours),
        "pyramid": partial(rasterize_points_pyramid, h, radius, *size, LEVELS),
        "torch scatter": partial(scatter_points, h, radius, *size),
    }
    point = ours().point
    row: dict[str, Any] = {
        "what": order,
        "count": len(points),
        "width": camera.width,
        "height": camera.height,
    }
    row["covered"] = float((point >= 0).float().mean())
    row["same as plain"] = _same(point, plain.points(h, radius, *size)[0], 0.99)
    row["same as torch"] = _same(point, scatter_points(h, radius, *size), 0.99)
    return {**row, "radius": radius, "times": alternate(calls, repeats)}


@click.command()
@click.option("--scene", type=click.Path(path_type=Path), help="Scene folder, for a real mesh.")
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("benchmarks/results"), show_default=True
)
@click.option("--repeats", type=click.IntRange(min=5), default=9, show_default=True)
def main(scene: Path | None, output: Path, repeats: int) -> None:
    """Time both rasterizers beside their peers.

    Example: python benchmarks/rasterizer.py --scene out/fox
    """
    results: dict[str, Any] = {
        "command": command(),
        **provenance(),
        "repeats": repeats,
        "faces": [],
        "points": [],
    }
    with tempfile.TemporaryDirectory() as folder:
        plain = PlainLoop(Path(folder))
        for count in FACES:
            vertices, faces = bumpy_sphere(count)
            for size in SIZES:
                row = measure_faces("sphere", vertices, faces, camera_for(*size), plain, repeats)
                results["faces"].append(row)
                click.echo(_row(row))
        if scene is not None:
            loaded = Scene.load(scene)
            held_out = (loaded.test or loaded.train)[0].camera
            for longer, _ in SIZES:
                scale = longer / max(held_out.width, held_out.height)
                camera = held_out.resized(round(scale * held_out.width), round(scale * held_out.height))
                mesh = loaded.mesh
                row = measure_faces(
                    "scene", mesh.vertices.astype(np.float64), mesh.faces, camera, plain, repeats
                )
                results["faces"].append(row)
                click.echo(_row(row))
        g = np.random.default_rng(0)
        near = bumpy_sphere(2 * POINTS)[0]
        far = g.normal(size=(BEHIND, 3))
        cloud = np.concatenate([near, 12 * far / np.linalg.norm(far, axis=1, keepdims=True)])
        orders = {"sorted": np.argsort(morton(cloud)), "random": g.permutation(len(cloud))}
        for size in SIZES:
            for order, permutation in orders.items():
                row = measure_points(order, cloud[permutation], camera_for(*size), plain, repeats)
                results["points"].append(row)
                click.echo(_row(row))
    write(output, "rasterizer", results, _table(results))


def _row(row: dict[str, Any]) -> str:
    times = row["times"]
    ours = times["nmbg"]["ms"]
    cells = [
        row["what"],
        f"{row['count'] / 1000:.0f} k",
        f"{row['width']}×{row['height']}",
        show(times["nmbg"]),
    ]
    for other in ("plain", "Open3D", "torch scatter"):
        if other in times:
            cells.append(f"{show(times[other])} = {times[other]['ms'] / ours:.2f} ×")
        elif other == "Open3D" and "torch scatter" not in times:
            cells.append("")
    cells += [f"{times['one thread']['ms'] / ours:.2f} ×", f"{times['pyramid']['ms'] / ours:.2f} ×"]
    return "| " + " | ".join(cells) + " |"


def _table(results: dict[str, Any]) -> str:
    tail = "one thread | five levels |"
    lines = [
        "Milliseconds, median (quartiles), and how many times nmbg's. All outputs agree",
        "in at least 99 % of the pixels; the plain loop is not compared on the scene, as it leaves out what "
        f"crosses the camera's plane. {results['machine']}",
        "",
        f"| faces | count | image | nmbg | plain loop | Open3D, tree built before | {tail}",
        "|---" * 8 + "|",
        *[_row(row) for row in results["faces"]],
        "",
        f"| points | count | image | nmbg | plain loop | torch scatter-min | {tail}",
        "|---" * 8 + "|",
        *[_row(row) for row in results["points"]],
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
