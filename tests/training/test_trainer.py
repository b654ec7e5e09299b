import csv
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.cli import main
from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
from nmbg.images import Image, write_image
from nmbg.model.exposure import Exposure
from nmbg.model.photographs import Gathered, Photographs
from nmbg.model.renderer import Renderer
from nmbg.scene import Scene, View
from nmbg.training import checkpoint, loop
from nmbg.training.config import PRESETS, TrainConfig
from nmbg.training.trainer import resume, train
from nmbg.training.views import Example

# No weights are at hand in a test: L_rec is left out, everything else is as in the presets.
SMALL = {
    name: replace(config, perceptual="none", minutes=None, epochs=None, iterations=6 if config.stages else 0)
    for name, config in PRESETS.items()
}
SMALL["paper"] = replace(SMALL["paper"], stages=(replace(PRESETS["paper"].stages[0], l1=1.0),))


def state(run: Path) -> dict[str, torch.Tensor]:
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    return {
        f"{path.stem}.{name}": tensor
        for path in sorted(found.glob("*.safetensors"))
        for name, tensor in checkpoint.load_file(path).items()
    }


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_preset_trains_and_renders(scene_folder: Path, tmp_path: Path, name: str) -> None:
    run = train(Scene.load(scene_folder), SMALL[name], tmp_path / "run")
    loaded = checkpoint.load_run(run)
    assert loaded.config == SMALL[name]
    view = Scene.load(scene_folder).test[0]
    assert loaded.renderer.render(view.camera).isfinite().all()


@pytest.mark.parametrize("faster", [True, False])
def test_networks_render_in_the_faster_precision(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, faster: bool
) -> None:
    monkeypatch.setattr(checkpoint, "bf16_is_faster", lambda device: faster)
    scene = Scene.load(scene_folder)
    for preset, expected in (("nmbg", faster), ("photos", False)):
        run = train(scene, replace(SMALL[preset], iterations=0), tmp_path / preset)
        assert checkpoint.load_run(run).renderer.bf16 is expected


def test_mesh_training_improves_on_its_start(scene_folder: Path, tmp_path: Path) -> None:
    config = replace(SMALL["mesh"], iterations=60, start="mean", validation_views=1)
    run = train(Scene.load(scene_folder), config, tmp_path / "run")
    with (run / "log.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["l1"]) < 0.8 * float(rows[0]["l1"])
    assert float(rows[-1]["validation_psnr"]) > float(rows[0]["validation_psnr"])


@pytest.mark.parametrize("name", ["mesh", "nmbg", "paper"])
@pytest.mark.parametrize("stop_at", [1, 4])
def test_resumed_equals_uninterrupted(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, stop_at: int
) -> None:
    config = SMALL[name]
    whole = state(train(Scene.load(scene_folder), config, tmp_path / "whole"))

    steps = 0
    differentiate = loop.differentiate

    def interrupt(*arguments: Any) -> bool:
        nonlocal steps
        steps += 1
        if steps == stop_at:
            signal.raise_signal(signal.SIGINT)
        return differentiate(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(loop, "differentiate", interrupt)
        with pytest.raises(KeyboardInterrupt):
            train(Scene.load(scene_folder), config, tmp_path / "resumed")
    assert steps == stop_at
    resumed = state(resume(tmp_path / "resumed"))
    assert whole.keys() == resumed.keys()
    for key, tensor in whole.items():
        assert torch.equal(tensor, resumed[key]), key


@pytest.mark.parametrize("preset", ["nmbg", "split"])
def test_a_killed_run_goes_on_as_if_nothing_had_been(scene_folder: Path, tmp_path: Path, preset: str) -> None:
    """SIGKILL at whatever step it is; a checkpoint is written at every one."""
    words = ["--preset", preset, "--iterations", "40", "--refine", "none", "--no-bf16", "--threads", "1"]
    words += ["--perceptual", "none"] if preset == "split" else []
    command = (
        "import sys; from nmbg.training import loop; loop.SAVE_EVERY = 0; from nmbg.cli import main; main()"
    )
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    start = [sys.executable, "-c", command, "train", str(scene_folder), *words, "--output"]
    process = subprocess.Popen([*start, str(killed)])
    while process.poll() is None:
        found = checkpoint.latest_checkpoint(killed) if killed.exists() else None
        if found is not None and int(found.name) >= 5:
            process.kill()
            break
        time.sleep(0.01)
    assert process.wait() == -signal.SIGKILL
    found = checkpoint.latest_checkpoint(killed)
    assert found is not None
    assert int(found.name) < 40
    again = [sys.executable, "-m", "nmbg", "train", "--resume", "--threads", "1", "--output", str(killed)]
    subprocess.run(again, check=True)
    subprocess.run([*start, str(whole)], check=True)
    one, other = state(killed), state(whole)
    assert one.keys() == other.keys()
    for name, tensor in other.items():
        assert torch.equal(one[name], tensor), name


@pytest.mark.parametrize(
    "words", [["--seed", "1"], ["--preset", "mesh"], ["--iterations", "9"], ["--no-bf16"]]
)
def test_a_resumed_run_refuses_other_options(scene_folder: Path, tmp_path: Path, words: list[str]) -> None:
    run = train(Scene.load(scene_folder), SMALL["photos"], tmp_path / "run")
    refused = CliRunner().invoke(main, ["train", "--resume", "--output", str(run), *words])
    assert refused.exit_code == 2
    assert words[0].replace("no-", "") in refused.stderr
    assert "keeps its own options" in refused.stderr


def test_the_log_tells_the_share_of_the_adversarial_loss(scene_folder: Path, tmp_path: Path) -> None:
    run = train(Scene.load(scene_folder), SMALL["adversarial"], tmp_path / "run")
    with (run / "log.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    told = [row for row in rows if row["adversarial"]]
    assert told
    for row in told:
        assert 0 < float(row["adversarial_share"]) <= 1.001
    assert "artificial ones" in (run / "cameras.svg").read_text()


def test_same_seed_same_run_and_another_seed_another(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    runs = [
        state(train(scene, replace(SMALL["nmbg"], seed=seed), tmp_path / str(i)))
        for i, seed in enumerate([1, 1, 2])
    ]
    key = "network.layers.0.weight"
    assert torch.equal(runs[0][key], runs[1][key])
    assert not torch.equal(runs[0][key], runs[2][key])


@pytest.mark.parametrize("preset", ["mesh", "nmbg"])
def test_numbers_are_the_same_kept_in_memory_or_on_disk_or_made_anew(
    scene_folder: Path, tmp_path: Path, preset: str
) -> None:
    scene, on_disk = Scene.load(scene_folder), 1e-9
    kept, mapped, anew = (
        state(train(scene, replace(SMALL[preset], cache_gib=gib), tmp_path / str(gib)))
        for gib in (1.0, on_disk, 0.0)
    )
    for key, tensor in kept.items():
        assert torch.equal(tensor, mapped[key]), key
        assert torch.equal(tensor, anew[key]), key


def test_test_views_are_never_read(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load_image, read = Scene.load_image, set()

    def spy(self: Scene, view: object) -> object:
        read.add(view.split)  # type: ignore[attr-defined]
        return load_image(self, view)  # type: ignore[arg-type]

    monkeypatch.setattr(Scene, "load_image", spy)
    train(Scene.load(scene_folder), SMALL["nmbg"], tmp_path / "run")
    assert read == {"train"}


def test_existing_run_is_kept(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    train(scene, SMALL["colours"], tmp_path / "run")
    with pytest.raises(NmbgError, match="overwrite"):
        train(scene, SMALL["colours"], tmp_path / "run")
    train(scene, SMALL["colours"], tmp_path / "run", overwrite=True)


def test_failure_leaves_nothing(scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device", "somewhere")

    monkeypatch.setattr(checkpoint, "save_checkpoint", fail)
    with pytest.raises(OSError, match="No space"):
        train(Scene.load(scene_folder), SMALL["colours"], tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_losses_that_stay_without_a_value_end_training_with_a_sound_checkpoint(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: Renderer, *_: object) -> torch.Tensor:
        return self.descriptors[0].coeffs.sum() * torch.full((3, 48, 64), torch.nan)

    with monkeypatch.context() as patch:
        patch.setattr(Renderer, "colour", broken)
        with pytest.raises(NmbgError, match="without a finite loss"):
            train(Scene.load(scene_folder), replace(SMALL["mesh"], iterations=100), tmp_path / "run")
    assert all(tensor.isfinite().all() for tensor in state(tmp_path / "run").values())


@pytest.mark.parametrize("name", ["mesh", "paper", "nmbg"])
def test_a_view_without_a_finite_loss_is_left_out_and_named(
    scene_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
) -> None:
    scene = Scene.load(scene_folder)
    poisoned = scene.train[1].name
    losses = loop.losses

    def poison(image: Tensor, *rest: Any) -> dict[str, Tensor]:
        example = next(a for a in rest if isinstance(a, Example))
        return losses(image * (torch.nan if example.name == poisoned else 1.0), *rest)

    monkeypatch.setattr(loop, "losses", poison)
    config = replace(SMALL[name], iterations=20, validation_views=0)
    run = train(scene, config, tmp_path / "run")
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    progress = checkpoint.load_progress(found)
    assert progress.step == 20
    assert set(progress.skipped) == {poisoned}
    assert progress.caution == 1.0  # never twice in a row
    assert all(tensor.isfinite().all() for tensor in state(run).values())
    assert poisoned in capsys.readouterr().err


def test_rates_fall_after_several_losses_in_a_row_that_are_not_finite(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    losses, calls = loop.losses, 0

    def poison(image: Tensor, *rest: Any) -> dict[str, Tensor]:
        nonlocal calls
        calls += 1
        return losses(image * (torch.nan if 2 < calls <= 2 + loop.PATIENCE else 1.0), *rest)

    monkeypatch.setattr(loop, "losses", poison)
    run = train(Scene.load(scene_folder), replace(SMALL["mesh"], iterations=12), tmp_path / "run")
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    assert checkpoint.load_progress(found).caution == loop.CAUTION


@pytest.fixture
def run(scene_folder: Path, tmp_path: Path) -> Path:
    config: TrainConfig = SMALL["mesh"]
    return train(Scene.load(scene_folder), config, tmp_path / "run")


@pytest.mark.parametrize("name", ["descriptors.safetensors", "progress.json", "optimisers.pt"])
@pytest.mark.parametrize("damage", [b"", b"not a checkpoint"])
def test_damaged_checkpoint_is_named(run: Path, name: str, damage: bytes) -> None:
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    (found / name).write_bytes(damage)
    with pytest.raises(NmbgError, match=str(found)):
        resume(run)


def test_foreign_checkpoint_is_named(run: Path, scene_folder: Path, tmp_path: Path) -> None:
    other = train(Scene.load(scene_folder), SMALL["colours"], tmp_path / "other")
    ours, theirs = checkpoint.latest_checkpoint(run), checkpoint.latest_checkpoint(other)
    assert ours is not None
    assert theirs is not None
    name = "descriptors.safetensors"
    (ours / name).write_bytes((theirs / name).read_bytes())
    with pytest.raises(NmbgError, match="another model or scene"):
        checkpoint.load_run(run)


@pytest.mark.parametrize("content", ["", "a: [", "scene: x\n", "- 1\n"])
def test_damaged_config_is_named(run: Path, content: str) -> None:
    (run / "config.yaml").write_text(content)
    with pytest.raises(NmbgError, match=r"config\.yaml"):
        checkpoint.load_run(run)


def test_no_run_folder(tmp_path: Path) -> None:
    with pytest.raises(NmbgError, match="not a run folder"):
        checkpoint.load_run(tmp_path)


def test_scene_and_run_move_together(run: Path, scene_folder: Path, tmp_path: Path) -> None:
    before = checkpoint.load_one(run)[0]
    assert before.resolve() == scene_folder.resolve()


@pytest.fixture
def photo_run(scene_folder: Path, tmp_path: Path) -> Path:
    config = replace(SMALL["photos"], photos=4)
    return train(Scene.load(scene_folder), config, tmp_path / "photo-run")


def test_a_run_renders_without_its_scene(photo_run: Path, scene_folder: Path, tmp_path: Path) -> None:
    """The run folder alone, elsewhere, shows the same picture: it holds the geometry and its photographs."""
    camera = Scene.load(scene_folder).test[0].camera
    here = checkpoint.load_run(photo_run).renderer.render(camera)
    elsewhere = Path(shutil.move(photo_run, tmp_path / "far" / "away"))
    moved = checkpoint.load_run(elsewhere)
    assert not moved.source.exists()
    assert torch.equal(here, moved.renderer.render(camera))
    assert len(list((elsewhere / "scene" / "images").iterdir())) == 4


@pytest.mark.parametrize("damage", [None, b"", b"no image"])
def test_a_photograph_that_the_run_lacks_is_named(
    photo_run: Path, scene_folder: Path, damage: bytes | None
) -> None:
    renderer = checkpoint.load_run(photo_run).renderer
    for path in (photo_run / "scene" / "images").iterdir():
        path.unlink() if damage is None else path.write_bytes(damage)
    with pytest.raises(NmbgError, match=str(photo_run / "scene" / "images")):
        renderer.render(Scene.load(scene_folder).test[0].camera)


def test_a_photograph_of_another_size_is_named(photo_run: Path, scene_folder: Path) -> None:
    renderer = checkpoint.load_run(photo_run).renderer
    for path in (photo_run / "scene" / "images").iterdir():
        write_image(path, np.zeros((7, 9, 3), np.uint8))
    with pytest.raises(NmbgError, match="9×7 pixels"):
        renderer.render(Scene.load(scene_folder).test[0].camera)


def test_a_network_learns_from_what_the_other_photographs_show(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Painting a training view's photograph black changes nothing of what the network sees of that view."""
    load_image, gather = Scene.load_image, Photographs.gather
    seen: dict[str, Gathered] = {}
    black = ""

    def spy(
        self: Photographs, camera: Camera, base: Tensor, depth: Tensor, without: set[str], colouring: int
    ) -> Gathered:
        (name,) = without
        seen[name] = gather(self, camera, base, depth, without, colouring)
        return seen[name]

    def painted(self: Scene, view: View) -> Image:
        image = load_image(self, view)
        return np.zeros_like(image) if view.name == black else image

    monkeypatch.setattr(Photographs, "gather", spy)
    monkeypatch.setattr(Scene, "load_image", painted)
    # Refinement moves the surface by all photographs alike; that is not what is asked here.
    config = replace(SMALL["nmbg"], inspect=False, iterations=1, validation_views=0, refine="none")
    train(Scene.load(scene_folder), config, tmp_path / "as-it-is")
    ((black, before),) = seen.items()
    train(Scene.load(scene_folder), config, tmp_path / "black")
    assert list(seen) == [black]
    for one, two in zip(before._parts, seen[black]._parts, strict=True):
        assert torch.equal(one, two)


def test_a_refined_run_keeps_its_geometry(scene_folder: Path, tmp_path: Path) -> None:
    scene = Scene.load(scene_folder)
    config = replace(SMALL["photos"], refine="geometry")
    run = train(scene, config, tmp_path / "run")
    kept = Scene.load(run / "scene").mesh
    assert np.array_equal(kept.faces, scene.mesh.faces)
    assert not np.array_equal(kept.vertices, scene.mesh.vertices)
    assert np.array_equal(checkpoint.load_run(run).renderer.layers[0].vertices, kept.vertices)


@pytest.mark.parametrize("preset", ["photos", "nmbg"])
def test_training_views_are_evaluated_without_their_photograph(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    """Painting one training photograph black in the scene and the run changes its target, not its render."""
    scene, load_image = Scene.load(scene_folder), Scene.load_image
    config = replace(SMALL[preset], iterations=0, refine="none")
    run = train(scene, config, tmp_path / "run")
    black = scene.train[2]

    def painted(self: Scene, view: View) -> Image:
        image = load_image(self, view)
        return np.zeros_like(image) if view.name == black.name else image

    evaluate(run, ["psnr"], split="train")
    before = [
        (run / "renders-train" / f"{Path(black.name).stem}{end}").read_bytes()
        for end in (".png", ".target.png")
    ]
    monkeypatch.setattr(Scene, "load_image", painted)
    evaluate(run, ["psnr"], split="train")
    after = [
        (run / "renders-train" / f"{Path(black.name).stem}{end}").read_bytes()
        for end in (".png", ".target.png")
    ]
    assert before[0] == after[0]
    assert before[1] != after[1]


def test_the_loss_looks_at_renders_as_the_photograph_was_exposed() -> None:
    stage = PRESETS["mesh"].stages[0]
    bright = torch.full((1, 3, 4, 4), 0.5, requires_grad=True)
    image = torch.full((3, 4, 4), 51, dtype=torch.uint8)
    camera = Camera(np.eye(3), np.eye(3), np.zeros(3), 4, 4)
    exposure = Exposure(torch.full((3, 1, 1), 0.4), torch.zeros(3, 1, 1))
    example = Example("a", camera, [], image, None, exposure)

    def compared(like: Example) -> float:
        image = loop.as_photographed(bright, like)
        return loop.losses(image, stage, None, None, like, torch.Generator())["l1"].item()

    assert compared(example) < 1e-6
    assert compared(replace(example, exposure=None)) > 0.29
