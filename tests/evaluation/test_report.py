"""report.html is well-formed, holds all it shows, and shows what it should."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import torch
import yaml

from nmbg.errors import NmbgError
from nmbg.evaluation.evaluate import evaluate
from nmbg.evaluation.features import feature_panels, principal_colours
from nmbg.evaluation.report import by_error, write_report
from nmbg.evaluation.results import read_results, write_results
from nmbg.scene import Scene
from nmbg.training import checkpoint
from nmbg.training.config import PRESETS
from nmbg.training.trainer import train


def parsed(path: Path) -> ET.Element:
    """The page as XML; refuses what would be loaded from elsewhere."""
    text = path.read_text(encoding="utf-8")
    assert "<script" not in text
    for reference in re.findall(r'(?:src|href)="([^"]*)"|url\(([^)]*)\)', text):
        assert all(part.startswith("data:image/") for part in reference if part)
    return ET.fromstring(text.split("\n", 1)[1])


def headings(page: ET.Element) -> list[str]:
    return [h.text or "" for h in page.iter("h2")]


def column(page: ET.Element, heading: str) -> list[str]:
    """First cells of the first table below a heading."""
    (section,) = [s for s in page.iter("section") if s.findtext("h2") == heading]
    table = next(section.iter("table"))
    return [row[0].text or "" for row in list(table)[1:]]


def test_a_trained_runs_report(scene_folder: Path, tmp_path: Path) -> None:
    config = replace(PRESETS["npbg-mesh"], iterations=3, perceptual="none", validation_views=1)
    stages = tuple(replace(stage, perceptual=0.0) for stage in config.stages)
    run = train(Scene.load(scene_folder), replace(config, stages=stages), tmp_path / "run")
    evaluate(run)
    page = parsed(run / "report.html")
    assert headings(page) == [
        "Metrics",
        "Speed and size",
        "Worst and best views",
        "Views, worst first",
        "Colours",
        "Rasterized features",
        "Training",
    ]
    captions = [c.text for c in page.iter("figcaption")]
    assert {"mesh, faces", "mesh, faces: occupancy", "mesh, points", "mesh, points: occupancy"} <= set(
        captions
    )
    assert len(list(page.iter("img"))) == len(captions)


def test_views_stand_from_worst_to_best(make_run) -> None:
    run = make_run()
    report = evaluate(run.folder, ("psnr",))
    report.views["a.jpg"]["psnr"], report.views["b.jpg"]["psnr"] = 30.0, 20.0
    assert [view.name for view in by_error(report, run.scene)] == ["b.jpg", "a.jpg"]
    page = parsed(write_report(run.folder, report, run.scene))
    assert column(page, "Views, worst first") == ["b.jpg", "a.jpg"]
    lower = replace(report, settings={"lpips_alex": ""})
    for name, value in (("a.jpg", 0.1), ("b.jpg", 0.2)):
        lower.views[name]["lpips_alex"] = value
    assert [view.name for view in by_error(lower, run.scene)] == ["b.jpg", "a.jpg"]


def test_names_are_escaped(make_run) -> None:
    run = make_run(names=("a<b>&.jpg", "b'\".jpg", "c.jpg"))
    evaluate(run.folder)
    assert column(parsed(run.folder / "report.html"), "Views, worst first") == ["a<b>&.jpg", "b'\".jpg"]


def test_splits_have_a_page_each(make_run) -> None:
    run = make_run()
    evaluate(run.folder)
    before = (run.folder / "report.html").read_bytes()
    evaluate(run.folder, split="train")
    assert (run.folder / "report.html").read_bytes() == before
    assert "training views" in (run.folder / "report-train.html").read_text()


def test_capacity_is_shown_where_the_run_records_it(make_run) -> None:
    run = make_run()
    report = evaluate(run.folder)
    assert "Capacity" not in headings(parsed(run.folder / "report.html"))
    record = {"choice": "harmonics: 1", "saves": "50 MB", "costs": "0.01 dB", "reason": "matt & plain"}
    (run.folder / "config.yaml").write_text(yaml.safe_dump({"choices": [record, {"choice": "no network"}]}))
    page = parsed(write_report(run.folder, report, run.scene))
    assert column(page, "Capacity") == ["harmonics: 1", "no network"]
    assert "matt &amp; plain" in (run.folder / "report.html").read_text()


def test_published_rows_stand_beside_ours(make_run) -> None:
    run = make_run()
    report = evaluate(run.folder, ("psnr", "ssim_svs"), table="dtu65")
    page = parsed(run.folder / "report.html")
    heading = "Published: DTU, scan 65"
    assert heading in headings(page)
    assert "NMBG (full)" in column(page, heading)
    (section,) = [s for s in page.iter("section") if s.findtext("h2") == heading]
    ours = [[cell.text for cell in row] for row in section.iter("tr") if row.get("class") == "ours"]
    assert ours == [["run (ours)", f"{report.mean['psnr']:.2f}", f"{report.mean['ssim_svs']:.3f}", None]]
    told = " ".join(item.text or "" for item in section.iter("li"))
    for part in ("ours is called scene", "1600×1200, ours 48×36", "with masks, ours without", "lpips_alex"):
        assert part in told


def test_results_survive_writing(make_run, tmp_path: Path) -> None:
    report = evaluate(make_run(error=0.0).folder, ("psnr", "ssim"))
    write_results(tmp_path, report)
    assert read_results(tmp_path) == report


@pytest.mark.parametrize("content", [None, "{", "[]", '{"run": "x"}', "null"])
def test_results_that_cannot_be_read(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "metrics.json").write_text(content)
    message = "not evaluated yet" if content is None else r"metrics\.json: damaged or of another version"
    with pytest.raises(NmbgError, match=message):
        read_results(tmp_path)


def test_principal_colours_ignore_empty_pixels_and_offsets() -> None:
    torch.manual_seed(0)
    features, mask = torch.randn(8, 20, 30), torch.rand(20, 30) > 0.3
    image = principal_colours(features, mask)
    assert not image[~mask.numpy()].any()
    assert image[mask.numpy()].min() == 0
    assert image[mask.numpy()].max() == 255
    moved = features + torch.arange(8.0)[:, None, None]
    moved[:, ~mask] = 1e6
    assert np.abs(principal_colours(moved, mask).astype(int) - image).max() <= 1
    assert not principal_colours(features, torch.zeros_like(mask)).any()


@pytest.mark.parametrize(
    ("preset", "titles"),
    [
        ("npbg", ["mesh, points"]),
        ("mesh", ["mesh, faces"]),
        ("photos", ["mesh, colours", "photographs, blended over the mesh"]),
        ("nmbg", ["mesh, colours", "photographs, blended over the mesh"]),
    ],
)
def test_panels_of_each_kind_of_model(scene_folder: Path, preset: str, titles: list[str]) -> None:
    scene = Scene.load(scene_folder)
    renderer = checkpoint.build_renderer(scene, PRESETS[preset])
    if PRESETS[preset].model.sources:
        renderer.remember(scene, scene.train)
    camera = scene.test[0].camera
    panels = feature_panels(renderer, camera)
    assert [panel.title for panel in panels] == titles
    for panel in panels:
        assert panel.features.shape == (camera.height, camera.width, 3)
        assert panel.occupancy.shape == (camera.height, camera.width)
        assert panel.occupancy.max() > 200
