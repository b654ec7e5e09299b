"""Another program's pictures, measured as our own."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from nmbg.cli import main
from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
from nmbg.evaluation.foreign import evaluate_renders, find_renders
from nmbg.evaluation.results import read_results
from nmbg.images import read_image, write_image
from nmbg.scene import Scene
from nmbg.training.config import PRESETS
from nmbg.training.trainer import train


def pictures(folder: Path, *names: str, size: tuple[int, int] = (48, 36)) -> Path:
    for i, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_image(folder / name, np.full((size[1], size[0], 3), 10 * i, np.uint8))
    return folder


@pytest.mark.parametrize("masks", [False, True])
def test_what_evaluate_rendered_gives_the_same_numbers(make_run, tmp_path, masks):
    run = make_run(masks=masks)
    ours = evaluate(run.folder, ("psnr", "ssim", "ssim_svs"))
    theirs = evaluate_renders(
        run.folder / "renders", run.scene.folder, "other", tmp_path / "out", ("psnr", "ssim", "ssim_svs")
    )
    assert theirs.mean == ours.mean
    assert theirs.colours == ours.colours
    assert (theirs.protocol, theirs.settings, theirs.geometry) == (
        ours.protocol,
        ours.settings,
        ours.geometry,
    )


def test_photographs_that_are_blended_give_the_same_numbers_by_the_command(
    scene_folder: Path, tmp_path: Path
):
    run = train(Scene.load(scene_folder), PRESETS["photos"], tmp_path / "run")
    ours = evaluate(run, ("psnr", "ssim", "ssim_svs"))
    words = [
        "eval",
        "--renders",
        str(run / "renders"),
        "--scene",
        str(scene_folder),
        "--label",
        "other system",
    ]
    words += ["--seconds-per-frame", "0.25", "--train-seconds", "120", "--megabytes", "3"]
    result = CliRunner().invoke(main, [*words, "--metrics", "psnr", "ssim", "ssim_svs"])
    assert result.exit_code == 0, result.output
    theirs = read_results(run / "renders-eval")
    assert theirs.mean == ours.mean
    assert {
        name: {m: v for m, v in values.items() if m != "seconds"} for name, values in ours.views.items()
    } == theirs.views
    assert (theirs.run, theirs.preset) == ("other system", None)
    assert (theirs.seconds_per_frame, theirs.train_seconds, theirs.megabytes) == (0.25, 120, 3)
    assert (run / "renders-eval" / "report.html").is_file()


@pytest.mark.parametrize(
    "names",
    [
        ("a.png", "b.png"),
        ("a.tif", "b.jpg", "unrelated.png"),
        ("test/a.png", "deep/er/b.png"),
        ("00000.png", "00001.png"),
        ("9.png", "10.png"),
        ("a.png", "a.target.png", "b.png"),
    ],
)
def test_pictures_are_found_by_name_or_number(make_run, tmp_path, names):
    views = make_run().scene.test
    found = find_renders(pictures(tmp_path / "renders", *names), views)
    chosen = [name for name in names if "target" not in name and "unrelated" not in name]
    assert found == {v.name: tmp_path / "renders" / n for v, n in zip(views, chosen, strict=True)}


def test_an_index_maps_them(make_run, tmp_path):
    folder = pictures(tmp_path / "renders", "x.png", "y.png")
    (tmp_path / "index.json").write_text(json.dumps({"a.jpg": "y.png", "b.jpg": "x.png", "c.jpg": "z.png"}))
    found = find_renders(folder, make_run().scene.test, tmp_path / "index.json")
    assert found == {"a.jpg": folder / "y.png", "b.jpg": folder / "x.png"}


@pytest.mark.parametrize(
    ("names", "index", "message"),
    [
        (("a.png",), None, r"no picture of b\.jpg; name the pictures"),
        (("0.png", "1.png", "2.png"), None, r"no picture of a\.jpg and 1 more views; .* number all 2"),
        (("one/a.png", "two/a.png", "b.png"), None, r"may both be the picture of a; remove one"),
        (("a.png", "b.png"), '{"a.jpg": "a.png"}', r"index\.json: names no picture of b\.jpg"),
        (("a.png", "b.png"), '["a.png"]', r"index\.json: expected JSON"),
        (("a.png", "b.png"), "a.jpg a.png", r"index\.json: expected JSON"),
        (("a.png", "b.png"), '{"a.jpg": 3, "b.jpg": 4}', r"index\.json: expected JSON"),
    ],
)
def test_pictures_that_cannot_be_matched(make_run, tmp_path, names, index, message):
    folder = pictures(tmp_path / "renders", *names)
    if index is not None:
        (tmp_path / "index.json").write_text(index)
    with pytest.raises(NmbgError, match=message):
        find_renders(folder, make_run().scene.test, tmp_path / "index.json" if index else None)


def test_no_picture_is_taken_for_two_views(make_run, tmp_path):
    views = [
        replace(view, name=f"{folder}/a.jpg")
        for view, folder in zip(make_run().scene.test, "xy", strict=True)
    ]
    with pytest.raises(NmbgError, match=r"picture of both x/a\.jpg and y/a\.jpg"):
        find_renders(pictures(tmp_path / "renders", "a.png"), views)


def test_a_wrong_size_names_the_expected_one_before_any_work(make_run, tmp_path):
    run = make_run()
    folder = pictures(tmp_path / "renders", "a.png", "b.png", size=(24, 36))
    with pytest.raises(
        NmbgError, match=r"a\.png: 24×36 pixels, expected 48×36, the size of the photograph a\.jpg"
    ):
        evaluate_renders(folder, run.scene.folder, "other", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_renders_are_kept_as_they_were_measured(make_run, tmp_path):
    folder = pictures(tmp_path / "renders", "a.png", "b.png")
    evaluate_renders(folder, make_run().scene.folder, "other", tmp_path / "out")
    assert np.array_equal(read_image(tmp_path / "out" / "renders" / "b.png"), read_image(folder / "b.png"))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--renders", "."], "--renders: needs --scene"),
        (["--renders", ".", "--scene", "."], "--renders: needs --label"),
        ([".", "--label", "x"], "--label: is about --renders"),
        ([".", "--renders", "."], "name one of the two"),
        ([], "Missing argument 'RUN'"),
        (["--renders", ".", "--scene", ".", "--label", "x", "--train-seconds", "-1"], "-1"),
    ],
)
def test_options_that_do_not_go_together(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["eval", *words])
    assert result.exit_code == 2
    assert message in result.output
