"""evaluate() end to end, with a renderer whose errors are known."""

import io
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from rich.console import Console

from nmbg import __version__
from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
from nmbg.evaluation.judge import render_names
from nmbg.evaluation.metrics import make_metrics
from nmbg.evaluation.tables import metrics_table
from nmbg.images import read_image


def tensor(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image).permute(2, 0, 1).double() / 255


def test_known_error_gives_known_psnr(make_run):
    run = make_run(error=26 / 255)  # a whole number of grey levels, so that rounding does nothing
    report = evaluate(run.folder, ("psnr",))
    assert list(report.views) == ["a.jpg", "b.jpg"]
    expected = -20 * math.log10(26 / 255)
    assert report.mean["psnr"] == pytest.approx(expected, abs=1e-5)
    assert all(values["psnr"] == pytest.approx(expected, abs=1e-5) for values in report.views.values())


def test_only_the_splits_views_are_rendered(make_run):
    run = make_run()
    held_out, training = ({id(v.camera) for v in views} for views in (run.scene.test, run.scene.train))
    evaluate(run.folder)
    assert set(run.renderer.rendered) == held_out
    run.renderer.rendered.clear()
    evaluate(run.folder, split="train")
    assert set(run.renderer.rendered) == training


@pytest.mark.parametrize(
    ("at_most", "names"), [(1, ["b.jpg"]), (2, ["a.jpg", "b.jpg"]), (9, ["a.jpg", "b.jpg"])]
)
def test_fewer_views_are_judged_where_that_is_asked_for(make_run, at_most, names):
    assert list(evaluate(make_run().folder, at_most=at_most).views) == names


def test_metrics_file_says_everything(make_run):
    run = make_run()
    report = evaluate(run.folder, ("psnr", "ssim", "ssim_svs"))
    content = json.loads((run.folder / "metrics.json").read_text())
    assert content["mean"] == report.mean
    assert content["views"] == report.views
    assert set(content["settings"]) == set(content["mean"]) == {"psnr", "ssim", "ssim_svs"}
    assert "data range 2" in content["settings"]["ssim_svs"]
    assert (content["run"], content["split"], content["preset"]) == ("run", "test", "mesh")
    assert content["nmbg"] == __version__
    assert content["geometry"].startswith("made up")
    assert "mask" not in content["protocol"]
    assert content["machine"]["threads"] == torch.get_num_threads()
    assert content["machine"]["cpu"]
    assert 0 < content["seconds_per_frame"] < 60
    assert content["peak_memory_gib"] > 0.01


def test_mean_is_of_the_values_per_view(make_run):
    run = make_run()
    report = evaluate(run.folder, ("psnr", "ssim"))
    for name, mean in report.mean.items():
        assert mean == pytest.approx(sum(v[name] for v in report.views.values()) / 2)


def test_metrics_can_be_found_again_from_the_files(make_run):
    run = make_run(masks=True)
    report = evaluate(run.folder, ("psnr", "ssim"))
    for view, name in zip(("a.jpg", "b.jpg"), ("a", "b"), strict=True):
        estimate, target = (
            tensor(read_image(run.folder / "renders" / f"{name}{kind}.png")) for kind in ("", ".target")
        )
        for metric in make_metrics(("psnr", "ssim")):
            assert metric.compute(estimate, target) == pytest.approx(report.views[view][metric.name])


def test_masks_black_out_both_images_and_count_over_the_full_frame(make_run):
    run = make_run(masks=True, error=26 / 255)
    report = evaluate(run.folder, ("psnr",))
    half = -10 * math.log10(0.5 * (26 / 255) ** 2)
    assert report.mean["psnr"] == pytest.approx(half, abs=1e-5)
    assert "multiplied by the mask" in report.protocol
    for kind in ("", ".target"):
        image = read_image(run.folder / "renders" / f"a{kind}.png")
        assert not image[:, 24:].any()
        assert image[:, :24].all()


def test_perfect_renders_are_infinite_in_memory_and_null_on_disk(make_run):
    run = make_run(error=0.0)
    report = evaluate(run.folder, ("psnr", "ssim"))
    assert report.mean["psnr"] == math.inf
    content = json.loads((run.folder / "metrics.json").read_text())
    assert content["mean"] == {"psnr": None, "ssim": 1.0}
    assert content["views"]["a.jpg"]["psnr"] is None


def test_training_views_leave_the_held_out_results_alone(make_run):
    run = make_run()
    evaluate(run.folder)
    before = {path: path.read_bytes() for path in run.folder.rglob("*") if path.is_file()}
    evaluate(run.folder, split="train")
    assert all(path.read_bytes() == content for path, content in before.items())
    assert (run.folder / "renders-train" / "sub" / "c.target.png").is_file()
    assert json.loads((run.folder / "metrics-train.json").read_text())["split"] == "train"


def test_evaluating_again_replaces_everything(make_run):
    run = make_run()
    evaluate(run.folder)
    (run.folder / "renders" / "old.png").touch()
    run.renderer.error = 0.2
    second = evaluate(run.folder)
    assert json.loads((run.folder / "metrics.json").read_text())["mean"] == second.mean
    assert not (run.folder / "renders" / "old.png").exists()


@pytest.mark.parametrize(
    ("photographs", "names"),
    [
        (("sub/a.png", "sub/b.png"), ["sub/a", "sub/b"]),
        (("sub/a.png", "sub/a.tif"), ["0.png", "1.png"]),
        (("../a.png", "b.png"), ["0.png", "1.png"]),
        (("/a.png", "b.png"), ["0.png", "1.png"]),
    ],
)
def test_renders_are_named_after_the_photographs_where_that_is_safe(make_run, photographs, names):
    view = make_run().scene.views[0]
    views = [replace(view, name=name, image=f"{i}.png") for i, name in enumerate(photographs)]
    assert render_names(views) == names


def test_sheet_shows_all_three_columns(make_run):
    run = make_run(error=26 / 255)
    evaluate(run.folder)
    sheet = read_image(run.folder / "sheet.png")
    assert sheet.shape[1] == 3 * (48 + 8) + 8
    render, truth = (read_image(run.folder / "renders" / f"a{kind}.png") for kind in ("", ".target"))
    np.testing.assert_array_equal(sheet[48 : 48 + 36, 8:56], render)
    np.testing.assert_array_equal(sheet[48 : 48 + 36, 64:112], truth)


def test_failure_in_the_middle_leaves_the_old_results(make_run):
    run = make_run()
    evaluate(run.folder)
    before = {path: path.read_bytes() for path in run.folder.rglob("*") if path.is_file()}
    run.renderer.photos[id(run.scene.test[1].camera)][0, 0, 0] = math.nan
    with pytest.raises(NmbgError, match=r"b.jpg: the render holds values that are not finite"):
        evaluate(run.folder)
    after = {path: path.read_bytes() for path in run.folder.rglob("*") if path.is_file()}
    assert before == after


def test_missing_lpips_weights_stop_before_rendering(make_run, tmp_path, monkeypatch):
    run = make_run()
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))

    def refuse(*args, **kwargs):
        raise OSError("offline")

    monkeypatch.setattr(torch.hub, "download_url_to_file", refuse)
    with pytest.raises(NmbgError, match=r"squeezenet1_1-b8a52dc0.pth: .*leave lpips out of --metrics"):
        evaluate(run.folder, ("psnr", "lpips"), "squeeze")
    assert not run.renderer.rendered
    assert not list(run.folder.iterdir())


def test_images_too_small_for_a_metric_stop_before_rendering(make_run):
    run = make_run(width=20, height=9)
    with pytest.raises(NmbgError, match=r"a.jpg: ssim needs images of 11 pixels a side, this has 9"):
        evaluate(run.folder, ("psnr", "ssim"))
    assert not run.renderer.rendered
    evaluate(run.folder, ("psnr", "ssim_svs"))


def test_scene_without_held_out_views(make_run):
    run = make_run(names=("a.jpg", "b.jpg"))
    with pytest.raises(NmbgError, match=r"no train views; evaluate with --split test"):
        evaluate(run.folder, split="train")


def test_table_shows_views_mean_and_settings(make_run):
    run = make_run(error=26 / 255)
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(metrics_table(evaluate(run.folder, ("psnr", "ssim_svs"))))
    text = console.export_text()
    for part in (
        "a.jpg",
        "b.jpg",
        "mean",
        "19.83",
        "data range 2",
        "per frame (median)",
        "training 1 minutes",
        "geometry: made up",
    ):
        assert part in text
