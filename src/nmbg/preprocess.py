"""From a capture to a scene folder: everything that is decided once, before training."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
import torch

from nmbg.atomic import atomic_folder, refuse_existing
from nmbg.cameras import Sphere, foreground_sphere, up_axis
from nmbg.errors import NmbgError
from nmbg.images import Mask
from nmbg.importers import Capture, Photo, read_capture
from nmbg.importers.splits import every_nth, read_split
from nmbg.importers.store import find_masks, store_photograph
from nmbg.mesh import Mesh, empty_mesh, in_morton_order, load_mesh, merge
from nmbg.progress import progress_bar
from nmbg.reconstruct.background import Background, best_background, make_background
from nmbg.reconstruct.colours import mean_vertex_colours, spread
from nmbg.reconstruct.coverage import SIGHT_SIZE, ViewCoverage, behind, count_coverage, mask_at
from nmbg.reconstruct.gallery import Gallery
from nmbg.scene import Scene, Split, View
from nmbg.sight import Sight, look

# A background pays from this share of uncovered training pixels on.
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
        background: "closed" (patches over the holes, shell behind), "shell", "none", or "auto".
        skip_missing: go on without photographs that the model names but the folder lacks.
    """

    images: Path | None = None
    mesh: Path | None = None
    masks: Path | None = None
    max_size: int | None = None
    test_every: int = 8
    split: Path | None = None
    layers: Literal["1", "2", "auto"] = "auto"
    background: Literal["closed", "shell", "none", "auto"] = "auto"
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
    """Decide sphere, background and layers; add patches and shell; colour everything."""
    mesh = in_morton_order(mesh)
    cameras = [view.camera for view in views if view.split == "train"]
    sphere = foreground_sphere(cameras)
    bare = Scene(folder, mesh, 0, 0, views, sphere.centre, sphere.radius, up_axis(cameras), 1, {}, source)

    sights, masks = _look(bare)
    seen = _coverage(bare, sights, masks, (len(mesh.faces), 0, 0))
    if max(view.mesh for view in seen if view.split == "train") < LEAST_COVERAGE:
        raise NmbgError(
            f"{options.mesh or source}: the mesh covers no training view; give one in the cameras' "
            "coordinate frame"
        )
    open_before = 1 - _share(seen, "mesh")
    background, chosen, why = _background(options.background, bare, sights, masks, seen)
    patches, shell = background.patches, background.shell
    whole = merge(mesh, background.whole)
    scene = replace(bare, mesh=whole, shell_vertices=len(shell.vertices), shell_faces=len(shell.faces))
    if len(background.whole.faces):
        sights = [
            behind(sight, look(background.whole, sight.camera), len(mesh.faces))
            for sight in _tracked(sights, "background coverage")
        ]
        seen = _coverage(scene, sights, masks, (len(mesh.faces), len(patches.faces), len(shell.faces)))
    layers, layers_why = _choose_layers(options.layers, sphere, [v for v in seen if v.split == "train"])
    summary = {
        "coverage": _coverage_summary(seen),
        "background": {"chosen": chosen, "why": why},
        "closing": {
            "vertices": len(patches.vertices),
            "faces": len(patches.faces),
            "open_before": open_before,
            "open_after": 1 - _share(seen, "mesh") - _share(seen, "patches"),
        },
        "layers": {"chosen": layers, "why": layers_why},
    }
    # The background comes in colours.
    has_colour = np.arange(len(whole.vertices)) >= (0 if coloured else len(mesh.vertices))
    painted = replace(whole, colours=_colours(scene, has_colour))
    return replace(scene, mesh=painted, layers=layers, summary=summary)


T = TypeVar("T")


def _tracked(items: Sequence[T], description: str) -> Iterator[T]:
    with progress_bar() as bar:
        yield from bar.track(items, description=description)


def _look(scene: Scene) -> tuple[list[Sight], list[Mask]]:
    """What every view sees of a scene's mesh, and its mask, both reduced."""
    sights, masks = [], []
    for view in _tracked(scene.views, "coverage"):
        sights.append(look(scene.mesh, view.camera.within(SIGHT_SIZE)))
        masks.append(mask_at(scene.load_mask(view), sights[-1].camera))
    return sights, masks


def _coverage(
    scene: Scene, sights: Sequence[Sight], masks: Sequence[Mask], parts: tuple[int, int, int]
) -> list[ViewCoverage]:
    """Count what the views see of a mesh whose faces are so many of the mesh, of patches and of the shell."""
    inside = np.linalg.norm(scene.mesh.vertices - scene.centre, axis=1) < scene.radius
    foreground = torch.from_numpy(inside[scene.mesh.faces].all(axis=1))
    return [
        count_coverage(view.split, mask, sight.face, parts, foreground)
        for view, sight, mask in zip(scene.views, sights, masks, strict=True)
    ]


def _share(seen: Sequence[ViewCoverage], part: str) -> float:
    """Share of the pixels of the training views inside their masks that see a part."""
    train = [view for view in seen if view.split == "train"]
    kept = [view.kept for view in train]
    return float(np.average([getattr(view, part) for view in train], weights=kept)) if sum(kept) else 0.0


def _background(
    wish: str, scene: Scene, sights: Sequence[Sight], masks: Sequence[Mask], seen: Sequence[ViewCoverage]
) -> tuple[Background, str, str]:
    """The background, its kind, and why it is of this kind."""
    chosen, why = _judge_by_coverage(wish, seen)
    if chosen == "none":
        return Background(empty_mesh(), empty_mesh()), chosen, why
    train = [i for i, view in enumerate(scene.views) if view.split == "train"]
    images = (scene.load_image(scene.views[i]) for i in _tracked(train, "holes"))
    gallery = Gallery.hang([sights[i] for i in train], images, [masks[i] for i in train])
    if chosen == "auto":
        chosen, why = best_background(gallery)
    return make_background(chosen, gallery), chosen, why


def _judge_by_coverage(wish: str, seen: Sequence[ViewCoverage]) -> tuple[str, str]:
    """What was asked for; of "auto", what the masks and the coverage decide already."""
    if wish != "auto":
        return wish, "as asked"
    kept = float(np.mean([view.kept for view in seen if view.split == "train"]))
    if kept < OBJECT_SHARE:
        return "none", f"the masks keep {kept:.0%} of the pixels: an object on a removed background"
    uncovered = 1 - _share(seen, "mesh")
    if uncovered <= UNCOVERED_SHARE:
        return "none", f"only {uncovered:.1%} of the training pixels see no mesh"
    return "auto", ""


def _choose_layers(wish: str, sphere: Sphere, train: list[ViewCoverage]) -> tuple[int, str]:
    if wish != "auto":
        return int(wish), "as asked"
    if not sphere.ring:
        return 1, "the cameras do not surround what they look at"
    near = sum(view.foreground for view in train)
    share = near / max(sum(view.mesh + view.patches + view.shell for view in train), 1e-9)
    layers = 2 if LAYER_SHARE <= share <= 1 - LAYER_SHARE else 1
    return layers, f"the cameras surround the scene; the foreground holds {share:.0%} of the covered pixels"


def _coverage_summary(seen: list[ViewCoverage]) -> dict[str, dict[str, float]]:
    columns = {
        "mesh": [view.mesh for view in seen],
        "patches": [view.patches for view in seen],
        "shell": [view.shell for view in seen],
        "together": [view.mesh + view.patches + view.shell for view in seen],
    }
    return {name: {"min": float(min(v)), "mean": float(np.mean(v))} for name, v in columns.items()}


def _colours(scene: Scene, coloured: npt.NDArray[np.bool_]) -> npt.NDArray[np.uint8]:
    """Mean observed colours; unseen, vertices that are `coloured` [N] keep theirs, others ask around."""
    photographs = (
        (view.camera, scene.load_image(view), scene.load_mask(view))
        for view in _tracked(scene.train, "colours")
    )
    mesh = scene.mesh
    colours, known = mean_vertex_colours(mesh, photographs)
    own = ~known & coloured
    colours[own] = mesh.colours[own]
    return spread(colours, known | own, mesh.faces).round().clip(0, 255).astype(np.uint8)


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
