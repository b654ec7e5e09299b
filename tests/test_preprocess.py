from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from nmbg.errors import NmbgError
from nmbg.images import write_image
from nmbg.mesh import load_mesh
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene
from nmbg.sight import look


def test_the_scene_holds_what_the_capture_showed(scene_folder: Path) -> None:
    scene = Scene.load(scene_folder)
    assert {path.name for path in scene_folder.glob("[!.]*")} == {"geometry.ply", "images", "scene.json"}
    summary = scene.summary
    assert (summary["images"]["registered"], summary["images"]["train"], summary["images"]["test"]) == (
        14,
        12,
        2,
    )
    assert summary["mesh"]["vertices"] + scene.shell_vertices == len(scene.mesh.vertices)
    assert summary["background"]["chosen"] == "shell", "what lies around is sky"
    assert all(f"{kind} " in summary["background"]["why"] for kind in ("none", "shell", "closed"))
    assert summary["closing"]["faces"] == 0
    assert summary["coverage"]["together"]["min"] == pytest.approx(1)
    assert 0.3 < summary["coverage"]["mesh"]["mean"] < 0.95
    assert summary["layers"]["why"]
    assert np.allclose(scene.up, [0, 0, 1], atol=0.1)


def test_vertex_colours_are_those_of_the_world(scene_folder: Path, shared_workspace: Path) -> None:
    from_photographs = Scene.load(scene_folder)
    seen = np.zeros(len(from_photographs.mesh.vertices), bool)
    for view in from_photographs.train:
        face = look(from_photographs.mesh, view.camera).face.numpy()
        seen[from_photographs.mesh.faces[np.unique(face[face >= 0])]] = True
    seen[len(seen) - from_photographs.shell_vertices :] = False
    x, y, z = from_photographs.mesh.vertices[seen].T
    truth = 255 * (0.5 + 0.4 * np.stack([np.sin(3 * x), np.sin(3 * y + 1), np.sin(3 * z + 2 * x)], axis=1))
    difference = np.abs(from_photographs.mesh.colours[seen] - truth)
    assert np.median(difference) < 12
    assert seen.sum() > 500


def test_unseen_vertices_keep_the_files_own_colours(workspace: Path, tmp_path: Path) -> None:
    path = workspace / "meshed-delaunay.ply"
    mesh = trimesh.load(path, process=False)
    below = trimesh.creation.icosphere(subdivisions=1, radius=0.2)
    below.apply_translation([0, 0, -0.5])
    both = trimesh.util.concatenate([mesh, below])
    both.visual.vertex_colors = np.tile(np.uint8([1, 2, 3, 255]), (len(both.vertices), 1))
    both.export(path)
    scene = preprocess(workspace, tmp_path / "scene", PreprocessOptions(background="none"))
    assert scene.summary["mesh"]["coloured"]
    unseen = {tuple(vertex) for vertex in below.vertices.astype(np.float32).tolist()}
    hidden = np.array([tuple(vertex) in unseen for vertex in scene.mesh.vertices.tolist()])
    assert hidden.sum() == len(below.vertices)
    assert (scene.mesh.colours[hidden] == [1, 2, 3]).all()
    assert (scene.mesh.colours[~hidden] != [1, 2, 3]).any()


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV_FISHEYE"])
def test_lenses_are_undistorted_to_the_cameras_that_are_stored(
    model: str, make_workspace: Callable[..., Path], tmp_path: Path
) -> None:
    source = make_workspace(tmp_path / "capture", model)
    scene = preprocess(source, tmp_path / "scene", PreprocessOptions(max_size=40))
    view = scene.train[0]
    assert max(view.camera.width, view.camera.height) == 40
    assert scene.load_image(view).shape == (view.camera.height, view.camera.width, 3)


@pytest.mark.parametrize(("wish", "layers"), [("1", 1), ("2", 2)])
def test_layers_can_be_chosen(wish: str, layers: int, shared_workspace: Path, tmp_path: Path) -> None:
    options = PreprocessOptions(layers=wish, background="none")
    scene = preprocess(shared_workspace, tmp_path / "scene", options)
    assert scene.layers == layers
    assert scene.shell_faces == 0
    assert scene.summary["layers"]["why"] == "as asked"


def test_patches_come_between_mesh_and_shell(make_workspace: Callable[..., Path], tmp_path: Path) -> None:
    """A hole in the ground: the patch lies about where the ground was."""
    workspace = make_workspace(tmp_path / "capture", n_cameras=9)
    path = workspace / "meshed-delaunay.ply"
    whole = trimesh.load(path, process=False)
    middle = whole.triangles_center
    hole = (np.abs(middle[:, 2]) < 1e-3) & (np.linalg.norm(middle[:, :2] - [1.5, 0], axis=1) < 0.45)
    path_of_whole = tmp_path / "whole.ply"
    whole.export(path_of_whole)
    whole.update_faces(~hole)
    whole.export(path)
    scene = preprocess(workspace, tmp_path / "scene", PreprocessOptions(background="closed"))
    closing, found = scene.summary["closing"], scene.summary
    n = found["mesh"]["vertices"]
    assert n + closing["vertices"] + scene.shell_vertices == len(scene.mesh.vertices)
    assert found["mesh"]["faces"] + closing["faces"] + scene.shell_faces == len(scene.mesh.faces)
    assert found["background"] == {"chosen": "closed", "why": "as asked"}
    assert closing["open_after"] < closing["open_before"]
    assert found["coverage"]["patches"]["mean"] > 0
    assert found["coverage"]["together"]["min"] == pytest.approx(1)
    ratio = []
    for view in scene.train:
        before = look(load_mesh(path_of_whole)[0], view.camera)
        in_hole = torch.isin(before.face, torch.from_numpy(np.flatnonzero(hole)))
        ratio.append((look(scene.mesh, view.camera).depth / before.depth)[in_hole])
    assert len(torch.cat(ratio)) > 50
    assert (torch.cat(ratio) - 1).abs().median() < 0.1, "photographs of some fifty pixels a side"


def write_masks(folder: Path, width: int = 64, height: int = 48) -> Path:
    """Masks that keep the middle of every image."""
    mask = np.zeros((height, width), np.uint8)
    mask[height // 4 : -height // 4, width // 4 : -width // 4] = 255
    folder.mkdir()
    for i in range(14):
        write_image(folder / f"{i:03d}.png", mask)
    return folder


def test_masks_of_an_object_leave_out_the_shell(workspace: Path, tmp_path: Path) -> None:
    write_masks(workspace / "mask")
    scene = preprocess(workspace, tmp_path / "scene", PreprocessOptions(masks=Path("mask"), max_size=32))
    assert scene.summary["background"]["chosen"] == "none"
    assert "removed background" in scene.summary["background"]["why"]
    mask = scene.load_mask(scene.views[0])
    assert mask is not None
    assert mask.shape == (24, 32)
    assert mask.mean() == pytest.approx(0.25)


def test_a_closed_surrounding_needs_no_shell(workspace: Path, tmp_path: Path) -> None:
    path = workspace / "meshed-delaunay.ply"
    surroundings = trimesh.creation.icosphere(subdivisions=3, radius=20)
    trimesh.util.concatenate([trimesh.load(path, process=False), surroundings]).export(path)
    scene = preprocess(workspace, tmp_path / "scene")
    assert scene.summary["background"]["chosen"] == "none"
    assert scene.layers == 2


def test_options_may_start_at_the_source(workspace: Path, tmp_path: Path) -> None:
    (workspace / "images").rename(workspace / "photographs")
    (workspace / "meshed-delaunay.ply").rename(workspace / "my.ply")
    (workspace / "split.json").write_text(json.dumps({"test": [3]}))
    options = PreprocessOptions(images=Path("photographs"), mesh=Path("my.ply"), split=Path("split.json"))
    scene = preprocess(workspace, tmp_path / "scene", options)
    assert [view.name for view in scene.test] == ["003.png"]


def test_images_in_neither_part_of_the_split_are_left_out(workspace: Path, tmp_path: Path) -> None:
    (workspace / "split.json").write_text(json.dumps({"test": [3], "train": [0, 1, 5, 7]}))
    scene = preprocess(workspace, tmp_path / "scene", PreprocessOptions(split=Path("split.json")))
    assert [view.name for view in scene.views] == ["000.png", "001.png", "003.png", "005.png", "007.png"]


def test_absent_images_stop_unless_skipped(workspace: Path, tmp_path: Path) -> None:
    (workspace / "images" / "004.png").unlink()
    with pytest.raises(NmbgError, match=r"004\.png: no such image.*--skip-missing"):
        preprocess(workspace, tmp_path / "scene")
    scene = preprocess(workspace, tmp_path / "scene", PreprocessOptions(skip_missing=True))
    assert len(scene.views) == 13
    assert scene.summary["images"]["absent"] == ["004.png"]


def damage_images(workspace: Path) -> PreprocessOptions:
    path = workspace / "images" / "005.png"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return PreprocessOptions()


def remove_images(workspace: Path) -> PreprocessOptions:
    shutil.rmtree(workspace / "images")
    return PreprocessOptions()


def leave_one_image(workspace: Path) -> PreprocessOptions:
    for i in range(1, 14):
        (workspace / "images" / f"{i:03d}.png").unlink()
    return PreprocessOptions(test_every=0, skip_missing=True)


def remove_mesh(workspace: Path) -> PreprocessOptions:
    (workspace / "meshed-delaunay.ply").unlink()
    return PreprocessOptions()


def name_no_mesh(workspace: Path) -> PreprocessOptions:
    return PreprocessOptions(mesh=Path("nothing.ply"))


def empty_mesh(workspace: Path) -> PreprocessOptions:
    (workspace / "meshed-delaunay.ply").write_bytes(b"")
    return PreprocessOptions()


def nan_mesh(workspace: Path) -> PreprocessOptions:
    mesh = trimesh.load(workspace / "meshed-delaunay.ply", process=False)
    mesh.vertices[7, 1] = np.nan
    mesh.export(workspace / "meshed-delaunay.ply")
    return PreprocessOptions()


def mesh_elsewhere(workspace: Path) -> PreprocessOptions:
    mesh = trimesh.load(workspace / "meshed-delaunay.ply", process=False)
    mesh.apply_translation([0, 0, 500])
    mesh.export(workspace / "meshed-delaunay.ply")
    return PreprocessOptions()


def small_masks(workspace: Path) -> PreprocessOptions:
    write_masks(workspace / "mask", 32, 24)
    return PreprocessOptions(masks=Path("mask"))


def no_masks(workspace: Path) -> PreprocessOptions:
    return PreprocessOptions(masks=Path("mask"))


def unknown_split(workspace: Path) -> PreprocessOptions:
    (workspace / "split.txt").write_text("017.png\n")
    return PreprocessOptions(split=Path("split.txt"))


def split_without_training(workspace: Path) -> PreprocessOptions:
    (workspace / "split.txt").write_text("\n".join(str(i) for i in range(14)))
    return PreprocessOptions(split=Path("split.txt"))


def everything_held_out(workspace: Path) -> PreprocessOptions:
    return PreprocessOptions(test_every=1)


def no_model(workspace: Path) -> PreprocessOptions:
    shutil.rmtree(workspace / "sparse")
    return PreprocessOptions()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (no_model, "no cameras found"),
        (remove_images, "--images"),
        (damage_images, r"005\.png: damaged or truncated"),
        (leave_one_image, "1 usable image"),
        (remove_mesh, "no mesh beside the model"),
        (name_no_mesh, r"nothing\.ply: no such mesh"),
        (empty_mesh, r"meshed-delaunay\.ply: .*--mesh"),
        (nan_mesh, "NaN"),
        (mesh_elsewhere, "covers no training view"),
        (small_masks, "32×24 pixels"),
        (no_masks, "no such folder of masks"),
        (unknown_split, r"no registered image '017\.png'"),
        (split_without_training, "leaves no training view"),
        (everything_held_out, "leaves no training view"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    spoil: Callable[[Path], PreprocessOptions], message: str, workspace: Path, tmp_path: Path
) -> None:
    options = spoil(workspace)
    with pytest.raises(NmbgError, match=message) as caught:
        preprocess(workspace, tmp_path / "out" / "scene", options)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.glob("out/*")) + list(tmp_path.glob("out/.*"))


def test_an_existing_scene_stays_unless_overwritten(shared_workspace: Path, tmp_path: Path) -> None:
    options = PreprocessOptions(background="none")
    preprocess(shared_workspace, tmp_path / "scene", options)
    (tmp_path / "scene" / "mine.txt").write_text("keep")
    with pytest.raises(NmbgError, match="--overwrite"):
        preprocess(shared_workspace, tmp_path / "scene", options)
    assert (tmp_path / "scene" / "mine.txt").read_text() == "keep"
    preprocess(shared_workspace, tmp_path / "scene", options, overwrite=True)
    assert not (tmp_path / "scene" / "mine.txt").exists()


def test_a_killed_process_leaves_no_scene(shared_workspace: Path, tmp_path: Path) -> None:
    """Killed outright while it writes: what remains is no scene, and the next run is not in its way."""
    target = tmp_path / "scene"
    code = (
        "import sys, time, nmbg.preprocess as p\n"
        "p._assemble = lambda *a: time.sleep(60)\n"
        "p.preprocess(p.Path(sys.argv[1]), p.Path(sys.argv[2]))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(shared_workspace), str(target)], stderr=subprocess.DEVNULL
    )
    while process.poll() is None and len(list(tmp_path.glob(".scene.*/images/*"))) < 9:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not target.exists()
    assert preprocess(shared_workspace, target, PreprocessOptions(background="none")).train


def test_the_same_capture_gives_the_same_scene(
    scene_folder: Path, shared_workspace: Path, tmp_path: Path
) -> None:
    again = preprocess(shared_workspace, tmp_path / "scene")
    first = Scene.load(scene_folder)
    assert np.array_equal(again.mesh.vertices, first.mesh.vertices)
    assert np.array_equal(again.mesh.colours, first.mesh.colours)
