"""From a capture to a scene folder: everything that is decided once, before training."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nmbg.atomic import atomic_folder, refuse_existing
from nmbg.cameras import Camera, Sphere, foreground_sphere, up_axis
from nmbg.errors import NmbgError
from nmbg.images import Image, Mask
from nmbg.importers import Capture, Photo, read_capture
from nmbg.importers.splits import every_nth, read_split
from nmbg.importers.store import find_masks, store_photograph
from nmbg.mesh import Mesh, load_mesh, merge
from nmbg.progress import progress_bar
from nmbg.reconstruct.colours import mean_vertex_colours, spread
from nmbg.reconstruct.coverage import ViewCoverage, count_coverage
from nmbg.reconstruct.shell import far_shell
from nmbg.scene import Scene, Split, View

# A shell pays from this share of uncovered training pixels on.
UNCOVERED_SHARE = 0.005
# Masks that keep less of the photographs than this show an object without its background.
OBJECT_SHARE = 0.8
# Two layers need at least this share of the covered training pixels in each.
LAYER_SHARE = 0.1
# Coverage below which a mesh is taken to be in another coordinate frame than the cameras.
LEAST_COVERAGE = 1e-3


@dataclass(frozen=True)
class PreprocessOptions:
    """What the user may choose.

    Args:
        images: folder of the photographs, when not at a usual place.
        mesh: the surface, when not under a usual name.
        masks: folder of masks, or None.
        max_size: longest side of the stored photographs, pixels; None keeps their size.
        test_every: hold out every n-th view by sorted name; 0 holds out none.
        split: split file; overrides `test_every`.
        layers: "1", "2", or "auto".
        background: "shell", "none", or "auto".
        skip_missing: go on without photographs that the model names but the folder lacks.
    """

    images: Path | None = None
    mesh: Path | None = None
    masks: Path | None = None
    max_size: int | None = None
    test_every: int = 8
    split: Path | None = None
    layers: Literal["1", "2", "auto"] = "auto"
    background: Literal["shell", "none", "auto"] = "auto"
    skip_missing: bool = False


def preprocess(
    source: Path, target: Path, options: PreprocessOptions = PreprocessOptions(), overwrite: bool = False
) -> Scene:
    """Make a scene folder from a capture.

    Relative paths in the options may start at the working directory or at `source`.

    Args:
        source: folder of the capture, in a format of `nmbg.importers`.
        target: the scene folder; appears complete or not at all.
        options: see there.
        overwrite: replace `target` when it exists.

    Raises:
        NmbgError: anything wrong with the input, named with its remedy.
    """
    refuse_existing(target, overwrite)
    capture = read_capture(source, _below(options.images, source))
    if capture.absent and not options.skip_missing:
        raise NmbgError(
            f"{capture.images / capture.absent[0]}: no such image, but the model names it "
            f"({len(capture.absent)} are absent); restore it, or pass --skip-missing"
        )
    splits = _splits(capture, options, source)
    photos = [photo for photo in capture.photos if photo.name in splits]
    if len(photos) < 2:
        raise NmbgError(f"{source}: {len(photos)} usable image; a scene needs two at least, add photographs")
    mesh_path = _below(options.mesh, source) or capture.mesh
    if mesh_path is None:
        raise NmbgError(
            f"{source}: no mesh beside the model; make one (colmap delaunay_mesher) or give it with --mesh"
        )
    mesh, coloured = load_mesh(mesh_path)
    masks_folder = _below(options.masks, source)
    masks = find_masks(masks_folder, [photo.name for photo in photos]) if masks_folder else {}

    with atomic_folder(target, overwrite) as folder:
        views = _store(photos, masks, splits, folder, options.max_size)
        scene = _assemble(folder, mesh, coloured, views, options, str(source))
        scene.summary.update(_found(capture, mesh_path, mesh, coloured, scene))
        scene.save(folder)
    return Scene.load(target)


def _below(path: Path | None, source: Path) -> Path | None:
    """A path as given, or below the source when it exists only there."""
    if path is None or path.exists() or not (source / path).exists():
        return path
    return source / path


def _splits(capture: Capture, options: PreprocessOptions, source: Path) -> dict[str, Split]:
    names = [photo.name for photo in capture.photos]
    split_file = _below(options.split, source)
    if split_file is not None:
        train, test = read_split(split_file, names)
    else:
        test = every_nth(names, options.test_every)
        train = sorted(set(names) - set(test))
    if not train:
        where = split_file if split_file is not None else f"--test-every {options.test_every}"
        raise NmbgError(f"{where}: leaves no training view of {len(names)}; hold out fewer")
    return {**dict.fromkeys(train, "train"), **dict.fromkeys(test, "test")}


def _store(
    photos: Sequence[Photo],
    masks: dict[str, Path],
    splits: dict[str, Split],
    folder: Path,
    max_size: int | None,
) -> tuple[View, ...]:
    """Write the photographs and masks as they will be trained on, several at a time."""

    def store(numbered: tuple[int, Photo]) -> View:
        i, photo = numbered
        camera, image, mask = store_photograph(photo, masks.get(photo.name), folder, f"{i:05d}", max_size)
        return View(photo.name, camera, splits[photo.name], image, mask)

    with ThreadPoolExecutor(os.cpu_count()) as pool, progress_bar() as bar:
        stored = pool.map(store, enumerate(photos))
        try:
            return tuple(bar.track(stored, total=len(photos), description="photographs"))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _assemble(
    folder: Path, mesh: Mesh, coloured: bool, views: tuple[View, ...], options: PreprocessOptions, source: str
) -> Scene:
    """Decide sphere, background and layers; add the shell; colour everything."""
    cameras = [view.camera for view in views if view.split == "train"]
    sphere = foreground_sphere(cameras)
    bare = Scene(folder, mesh, 0, 0, views, sphere.centre, sphere.radius, up_axis(cameras), 1, {}, source)

    seen = count_coverage(bare, "coverage")
    if max(view.mesh for view in seen) < LEAST_COVERAGE:
        raise NmbgError(
            f"{options.mesh or source}: the mesh covers no view; give one in the cameras' coordinate frame"
        )
    background, background_why = _choose_background(
        options.background, [v for v in seen if v.split == "train"]
    )
    shell = far_shell(mesh, cameras) if background == "shell" else None
    whole = mesh if shell is None else merge(mesh, shell)
    n_vertices, n_faces = len(whole.vertices) - len(mesh.vertices), len(whole.faces) - len(mesh.faces)
    uncoloured = Scene(
        folder, whole, n_vertices, n_faces, views, sphere.centre, sphere.radius, bare.up, 1, {}, source
    )
    if shell is not None:
        seen = count_coverage(uncoloured, "shell coverage")
    layers, layers_why = _choose_layers(options.layers, sphere, [v for v in seen if v.split == "train"])
    summary = {
        "coverage": _coverage_summary(seen),
        "background": {"chosen": background, "why": background_why},
        "layers": {"chosen": layers, "why": layers_why},
    }
    coloured_mesh = Mesh(whole.vertices, whole.faces, _colours(uncoloured, coloured))
    return Scene(
        folder,
        coloured_mesh,
        n_vertices,
        n_faces,
        views,
        sphere.centre,
        sphere.radius,
        bare.up,
        layers,
        summary,
        source,
    )


def _choose_background(wish: str, train: list[ViewCoverage]) -> tuple[str, str]:
    if wish != "auto":
        return wish, "as asked"
    kept = float(np.mean([view.kept for view in train]))
    if kept < OBJECT_SHARE:
        return "none", f"the masks keep {kept:.0%} of the pixels: an object on a removed background"
    uncovered = 1 - float(np.average([view.mesh for view in train], weights=[view.kept for view in train]))
    if uncovered > UNCOVERED_SHARE:
        return "shell", f"{uncovered:.1%} of the training pixels see no mesh"
    return "none", f"only {uncovered:.1%} of the training pixels see no mesh"


def _choose_layers(wish: str, sphere: Sphere, train: list[ViewCoverage]) -> tuple[int, str]:
    if wish != "auto":
        return int(wish), "as asked"
    if not sphere.ring:
        return 1, "the cameras do not surround what they look at"
    near = sum(view.foreground for view in train)
    share = near / max(sum(view.mesh + view.shell for view in train), 1e-9)
    layers = 2 if LAYER_SHARE <= share <= 1 - LAYER_SHARE else 1
    return layers, f"the cameras surround the scene; the foreground holds {share:.0%} of the covered pixels"


def _coverage_summary(seen: list[ViewCoverage]) -> dict[str, dict[str, float]]:
    columns = {
        "mesh": [view.mesh for view in seen],
        "shell": [view.shell for view in seen],
        "together": [view.mesh + view.shell for view in seen],
    }
    return {name: {"min": float(min(v)), "mean": float(np.mean(v))} for name, v in columns.items()}


def _colours(scene: Scene, coloured: bool) -> npt.NDArray[np.uint8]:
    """Mean observed colours; unseen vertices keep the file's own, or take their neighbours'."""

    def photographs() -> Iterator[tuple[Camera, Image, Mask | None]]:
        with progress_bar() as bar:
            for view in bar.track(scene.train, description="colours"):
                yield view.camera, scene.load_image(view), scene.load_mask(view)

    mesh = scene.mesh
    colours, known = mean_vertex_colours(mesh, photographs())
    if coloured:
        own = ~known
        own[len(own) - scene.shell_vertices :] = False
        colours[own] = mesh.colours[own]
        known |= own
    return spread(colours, known, mesh.faces).round().clip(0, 255).astype(np.uint8)


def _found(capture: Capture, mesh_path: Path, mesh: Mesh, coloured: bool, scene: Scene) -> dict[str, Any]:
    first = scene.views[0].camera
    return {
        "source": capture.description,
        "images": {
            "folder": str(capture.images),
            "registered": len(capture.photos) + len(capture.absent),
            "found": len(capture.photos) + len(capture.absent) + len(capture.unregistered),
            "unregistered": list(capture.unregistered),
            "absent": list(capture.absent),
            "train": len(scene.train),
            "test": len(scene.test),
            "size": [first.width, first.height],
        },
        "mesh": {
            "file": str(mesh_path),
            "vertices": len(mesh.vertices),
            "faces": len(mesh.faces),
            "coloured": coloured,
        },
        "shell": {"vertices": scene.shell_vertices, "faces": scene.shell_faces},
        "sphere": {"centre": scene.centre.tolist(), "radius": scene.radius},
    }
