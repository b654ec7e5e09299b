"""One network over several scenes: in one process, in memory or streamed, and in two that torchrun starts."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from click.testing import CliRunner
from torch import Tensor

from nmbg.cli import main
from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
from nmbg.preprocess import PreprocessOptions, preprocess
from nmbg.scene import Scene
from nmbg.training import checkpoint, full, loop
from nmbg.training.config import PRESETS
from nmbg.training.full import resume_together, train_together
from nmbg.training.member import Member, begin
from nmbg.training.targets import PerceptualTerm
from nmbg.training.trainer import train, with_layers

SMALL = replace(
    PRESETS["split"], perceptual="none", minutes=None, epochs=None, iterations=12, validation_views=1
)


@pytest.fixture(scope="module")
def scenes(
    scene_folder: Path, shared_workspace: Path, tmp_path_factory: pytest.TempPathFactory
) -> list[Path]:
    """Two scenes of different sizes."""
    folder = tmp_path_factory.mktemp("scenes") / "small"
    preprocess(shared_workspace, folder, PreprocessOptions(test_every=4, max_size=40, layers="2"))
    large = folder.with_name("large")
    preprocess(shared_workspace, large, PreprocessOptions(test_every=3, layers="2"))
    return [large, folder]


def state(run: Path) -> dict[str, Tensor]:
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    return {
        f"{run.name}/{path.stem}.{name}": tensor
        for path in sorted(found.glob("*.safetensors"))
        for name, tensor in checkpoint.load_file(path).items()
    }


def whole(run: Path) -> dict[str, Tensor]:
    states = state(run)
    for scene in sorted((run / "scenes").iterdir()):
        states |= state(scene)
    return {key.removeprefix(f"{run.name}/"): tensor for key, tensor in states.items()}


def assert_same(a: dict[str, Tensor], b: dict[str, Tensor]) -> None:
    assert a.keys() == b.keys()
    for key, tensor in a.items():
        assert torch.equal(tensor, b[key]), key


@contextmanager
def interrupted_at(step: int) -> Iterator[None]:
    """Ask training to stop in the middle of a step."""
    differentiate, steps = loop.differentiate, 0

    def interrupt(*arguments: Any) -> bool:
        nonlocal steps
        steps += 1
        if steps == step:
            signal.raise_signal(signal.SIGINT)
        return differentiate(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "differentiate", interrupt)
        yield


def test_scenes_share_the_network_and_have_their_own_descriptors(scenes: list[Path], tmp_path: Path) -> None:
    run = train_together(scenes, SMALL, tmp_path / "run")
    shared = {k.removeprefix("run/"): v for k, v in state(run).items()}
    for scene in scenes:
        own = run / "scenes" / scene.name
        found = {k.removeprefix(f"{scene.name}/"): v for k, v in state(own).items()}
        assert_same(shared, {k: v for k, v in found.items() if k.startswith("network.")})
        assert any(v.abs().sum() > 0 for k, v in found.items() if k.startswith("descriptors."))
        report = evaluate(own, ["psnr"])
        assert report.mean["psnr"] > 3
    assert not (run / "metrics.json").exists()
    with pytest.raises(NmbgError, match=r"holds 2 scenes; name one of them: .*scenes/large"):
        evaluate(run, ["psnr"])


def test_a_scene_can_be_taken_away_and_dropped(scenes: list[Path], tmp_path: Path) -> None:
    run = train_together(scenes, SMALL, tmp_path / "run")
    exported = shutil.move(run / "scenes" / "small", tmp_path / "run" / "elsewhere")
    camera = Scene.load(scenes[1]).test[0].camera
    assert checkpoint.load_run(Path(exported)).renderer.render(camera).isfinite().all()
    assert checkpoint.load_run(run / "scenes" / "large").renderer.render(camera).isfinite().all()


@pytest.mark.parametrize("preset", ["split", "nmbg"])
def test_streaming_from_disk_changes_no_bit(scenes: list[Path], tmp_path: Path, preset: str) -> None:
    config = replace(
        PRESETS[preset], perceptual="none", refine="none", minutes=None, iterations=24, validation_views=1
    )
    kept = whole(train_together(scenes, config, tmp_path / "kept"))
    streamed = whole(train_together(scenes, replace(config, cache_gib=0.0), tmp_path / "streamed"))
    assert_same(kept, streamed)


@pytest.mark.parametrize("stop_at", [1, 9])
def test_resumed_equals_uninterrupted(scenes: list[Path], tmp_path: Path, stop_at: int) -> None:
    config = replace(
        SMALL,
        stages=(replace(SMALL.stages[0], adversarial=0.1), replace(SMALL.stages[1], adversarial=0.1)),
        artificial_views=0.3,
    )
    expected = whole(train_together(scenes, config, tmp_path / "whole"))
    with interrupted_at(stop_at), pytest.raises(KeyboardInterrupt):
        train_together(scenes, config, tmp_path / "resumed")
    assert_same(expected, whole(resume_together(tmp_path / "resumed")))


def test_a_crash_between_checkpoints_goes_back_to_the_last_whole_one(
    scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Streamed scenes are written between the run's checkpoints: what is newer than these does not count."""
    config = replace(SMALL, cache_gib=0.0)
    expected = whole(train_together(scenes, config, tmp_path / "whole"))
    with monkeypatch.context() as patch:
        patch.setattr(loop, "descend", _fail_after(10))
        with pytest.raises(ZeroDivisionError):
            train_together(scenes, config, tmp_path / "resumed")
    assert_same(expected, whole(resume_together(tmp_path / "resumed")))


def _fail_after(steps: int) -> Any:
    descend, done = loop.descend, 0

    def step(*arguments: Any) -> None:
        nonlocal done
        done += 1
        if done > steps:
            raise ZeroDivisionError
        descend(*arguments)

    return step


def test_fine_tuning_begins_with_the_network_of_the_full_run(scenes: list[Path], tmp_path: Path) -> None:
    full = train_together(scenes, SMALL, tmp_path / "full")
    tuned = train(Scene.load(scenes[1]), replace(SMALL, iterations=0), tmp_path / "tuned", init=full)
    network = {k: v for k, v in state(full).items() if "/network." in k}
    for key, tensor in network.items():
        assert torch.equal(tensor, state(tuned)[key.replace("full/", "tuned/")])
    # The descriptors are the scene's own, from their usual start.
    fresh = train(Scene.load(scenes[1]), replace(SMALL, iterations=0), tmp_path / "fresh")
    assert torch.equal(state(tuned)["tuned/descriptors.0.coeffs"], state(fresh)["fresh/descriptors.0.coeffs"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{large}", "{large}", "--preset", "split"], "same last name"),
        (["{large}", "{small}", "--preset", "mesh"], "no network that scenes could share"),
        (["{large}", "--preset", "split", "--init", "{empty}"], "not a run folder"),
        (["{large}", "--preset", "npbg", "--init", "{run}"], "layers 2, preset npbg has 1"),
        (["{large}", "--preset", "mesh", "--init", "{run}"], "no network; leave it out"),
        (["{large}", "--preset", "mesh", "--adversarial", "1"], "trains no network"),
        (["{large}", "--preset", "split", "--artificial-views", "0.5"], "need an adversarial loss"),
        (["{large}", "--preset", "split", "--adversarial", "-1"], "is not in the range"),
        (["{large}", "--preset", "split", "--artificial-views", "1"], "is not in the range"),
    ],
)
def test_bad_input_is_one_line(
    scenes: list[Path], tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "empty").mkdir()
    places = {"large": scenes[0], "small": scenes[1], "empty": tmp_path / "empty", "run": tmp_path / "run"}
    if "{run}" in arguments:
        train(Scene.load(scenes[0]), replace(SMALL, iterations=0), tmp_path / "run")
    words = [word.format(**places) for word in arguments]
    command = ["train", *words, "--output", str(tmp_path / "out"), "--perceptual", "none"]
    if "mesh" in arguments:
        command = command[:-2]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_scene_removed_between_runs_is_named(scenes: list[Path], tmp_path: Path) -> None:
    for scene in scenes:
        shutil.copytree(scene, tmp_path / scene.name)
    copies = [tmp_path / scene.name for scene in scenes]
    with interrupted_at(3), pytest.raises(KeyboardInterrupt):
        train_together(copies, SMALL, tmp_path / "run")
    shutil.rmtree(copies[0])
    with pytest.raises(NmbgError, match=str(copies[0])):
        resume_together(tmp_path / "run")


def start(*words: object, program: Sequence[str] = ("-m", "nmbg")) -> "subprocess.Popen[str]":
    """`torchrun nmbg train` in two processes of one thread each."""
    launcher = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2"]
    rest = ["--rdzv-backend", "c10d", "--rdzv-endpoint", "localhost:0", *program, "train"]
    return subprocess.Popen(
        [*launcher, *rest, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def torchrun(*words: object, **options: Any) -> "subprocess.CompletedProcess[str]":
    process = start(*words, **options)
    out, err = process.communicate(timeout=300)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


OPTIONS = ("--preset", "split", "--perceptual", "none", "--no-bf16", "--validation-views", 1)


def test_two_processes_train_together_and_one_goes_on(scenes: list[Path], tmp_path: Path) -> None:
    run = tmp_path / "run"
    result = torchrun(*scenes, *OPTIONS, "--epochs", 2, "--output", run)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == str(run)
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    progress = checkpoint.load_progress(found)
    views = [len(Scene.load(scene).train) - 1 for scene in scenes]
    # Two passes of the process with more images; the other repeats some of its own.
    assert progress.step == 2 * max(views)
    assert progress.scenes == {scene.name: 2 * max(views) for scene in scenes}
    for scene in scenes:
        network = {k.split("/")[1]: v for k, v in state(run / "scenes" / scene.name).items()}
        for key, tensor in state(run).items():
            assert torch.equal(tensor, network[key.split("/")[1]])
    # The same run, alone, has twice the steps to do, and is half over.
    config = run / "config.yaml"
    config.write_text(config.read_text().replace("epochs: 2", "epochs: 4"))
    resume_together(run)
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    assert checkpoint.load_progress(found).step == 4 * sum(views)


def test_one_process_is_followed_by_two(scenes: list[Path], tmp_path: Path) -> None:
    run = tmp_path / "run"
    config = replace(SMALL, iterations=None, epochs=3)
    with interrupted_at(4), pytest.raises(KeyboardInterrupt):
        train_together(scenes, config, run)
    result = torchrun("--resume", "--output", run)
    assert result.returncode == 0, result.stderr
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    views = [len(Scene.load(scene).train) - 1 for scene in scenes]
    assert checkpoint.load_progress(found).step == 3 * max(views)


def test_two_processes_give_the_same_bits_again(scenes: list[Path], tmp_path: Path) -> None:
    for name in ("a", "b"):
        result = torchrun(*scenes, *OPTIONS, "--iterations", 6, "--output", tmp_path / name)
        assert result.returncode == 0, result.stderr
    assert_same(whole(tmp_path / "a"), whole(tmp_path / "b"))


def test_more_processes_than_scenes_are_refused(scenes: list[Path], tmp_path: Path) -> None:
    result = torchrun(scenes[0], *OPTIONS, "--iterations", 6, "--output", tmp_path / "run")
    assert result.returncode != 0
    assert "2 processes for 1 scene" in result.stderr
    assert not (tmp_path / "run").exists()


def test_processes_that_were_given_different_scenes_are_refused(scenes: list[Path], tmp_path: Path) -> None:
    shutil.copytree(scenes[1], tmp_path / "other")
    program = tmp_path / "program.py"
    program.write_text(
        "import os, sys\n"
        "from nmbg.cli import main\n"
        f"if os.environ['RANK'] == '1': sys.argv[2] = {str(tmp_path / 'other')!r}\n"
        "main()\n"
    )
    run = tmp_path / "run"
    result = torchrun(*scenes, *OPTIONS, "--iterations", 6, "--output", run, program=[str(program)])
    assert result.returncode != 0
    assert "the processes were given different scenes" in result.stderr
    assert not run.exists()


@pytest.mark.skipif(sys.platform != "linux", reason="looks for the processes in /proc")
def test_a_process_that_dies_ends_the_run_with_a_message_and_a_checkpoint(
    scenes: list[Path], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    process = start(*scenes, *OPTIONS, "--iterations", 100_000, "--output", run)
    while process.poll() is None and not (run / "log.csv").exists():
        time.sleep(0.1)
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    os.kill(int(workers[1]), signal.SIGKILL)
    _, err = process.communicate(timeout=120)
    assert process.returncode != 0
    assert "another one has ended" in err
    assert "go on with --resume" in err
    (run / "config.yaml").write_text(
        (run / "config.yaml").read_text().replace("iterations: 100000", "iterations: 4")
    )
    resume_together(run)
    found = checkpoint.latest_checkpoint(run)
    assert found is not None
    assert checkpoint.load_progress(found).step == 4


def test_views_of_the_same_name_have_features_of_their_own(
    scenes: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both scenes hold the same capture, at different sizes."""

    class Pixels:
        scale = 1.0

        def features(self, image: Tensor) -> list[Tensor]:
            return [image]

        def distance(self, a: list[Tensor], b: list[Tensor], mask: Tensor | None) -> Tensor:
            assert a[0].shape == b[0].shape
            return (a[0] - b[0]).abs().mean()

    asked = set()

    class Named(PerceptualTerm):
        def of_target(self, name: str, image: Tensor) -> list[Tensor]:
            asked.add(name)
            return super().of_target(name, image)

    term = Named(cast(Any, Pixels()), 1.0)
    monkeypatch.setattr(full, "make_perceptual", lambda *_: term)
    config = replace(SMALL, iterations=None, epochs=3, perceptual="vgg19")
    run = train_together(scenes, config, tmp_path / "run")
    names = {f"{folder.name}/{view.name}" for folder in scenes for view in Scene.load(folder).train}
    assert len(asked) > 2
    assert asked <= names
    # What a scene's own folder says of its training is the run's.
    for folder in scenes:
        found = checkpoint.latest_checkpoint(run / "scenes" / folder.name)
        assert found is not None
        assert checkpoint.load_progress(found).seconds > 0


def test_a_second_layer_only_where_a_scene_has_one(scenes: list[Path], tmp_path: Path) -> None:
    two = Scene.load(scenes[0])
    one = replace(two, layers=1)
    assert with_layers(SMALL, [one, two], None).model.layers == 2
    assert with_layers(SMALL, [one], None).model.layers == 1
    begun = train(two, replace(SMALL, iterations=0), tmp_path / "run")
    assert with_layers(SMALL, [one], begun).model.layers == 2


def test_scenes_of_one_layer_and_of_two_share_a_network(
    scenes: list[Path], shared_workspace: Path, tmp_path: Path
) -> None:
    flat = tmp_path / "flat"
    preprocess(shared_workspace, flat, PreprocessOptions(test_every=4, max_size=40, layers="1"))
    run = train_together([scenes[0], flat], SMALL, tmp_path / "run")
    for folder in (scenes[0], flat):
        one = checkpoint.load_run(run / "scenes" / folder.name)
        assert one.config.model.layers == 2
        assert one.renderer.render(Scene.load(folder).test[0].camera).isfinite().all()


def test_photographs_that_are_kept_ready_count_as_held(scene_folder: Path, tmp_path: Path) -> None:
    config = replace(PRESETS["nmbg"], refine="none", minutes=None, iterations=1)
    scene, config, renderer, fit = begin(Scene.load(scene_folder), config, tmp_path, None)
    member = Member(tmp_path, scene, config, renderer, fit)
    before = member.nbytes
    member.example(0, 0)
    assert member.left_out is not None
    assert member.left_out.nbytes > 0
    assert member.nbytes >= before + member.left_out.nbytes
