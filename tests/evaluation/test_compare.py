"""Results side by side."""

import io
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from click.testing import CliRunner
from rich.console import Console

from nmbg.cli import main
from nmbg.evaluation.compare import comparison_table, disagreements, read_all, write_comparison
from nmbg.evaluation.evaluate import evaluate
from nmbg.evaluation.foreign import evaluate_renders
from nmbg.evaluation.results import read_results, write_results


@pytest.fixture
def results(make_run, tmp_path: Path) -> tuple[Path, Path]:
    """A run, and a worse one whose pictures come as another program's."""
    run = make_run(error=0.05)
    evaluate(run.folder)
    better = tmp_path / "better"
    shutil.copytree(run.folder, better)
    write_results(better, replace(read_results(better), run="better"))
    run.renderer.error = 0.2
    evaluate(run.folder)
    evaluate_renders(
        run.folder / "renders", run.scene.folder, "other", tmp_path / "worse", seconds_per_frame=9.0
    )
    return better, tmp_path / "worse"


def test_the_page_marks_the_best_and_shows_the_pictures(results, tmp_path: Path) -> None:
    write_comparison(tmp_path / "page.html", read_all(results))
    text = (tmp_path / "page.html").read_text()
    assert "<script" not in text
    page = ET.fromstring(text.split("\n", 1)[1])
    table = list(next(page.iter("table")))
    assert [row[0].text for row in table] == ["result", "better", "other"]
    assert [cell.get("class") for cell in table[1]] == [None, "best", "best", None, "best", None]
    assert [cell.text for cell in table[2]][3:] == [None, "9e+03", None]
    assert all(image.get("src", "").startswith("data:image/") for image in page.iter("img"))
    assert len(list(page.iter("img"))) == 2 * 3


def test_the_terminal_shows_the_same(results) -> None:
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(comparison_table(read_all(results)))
    text = console.export_text()
    for part in ("better", "other", "psnr", "ms / frame", "as their user told them"):
        assert part in text


def test_results_of_one_name_are_called_by_their_folders(results, tmp_path: Path) -> None:
    shutil.copytree(results[0], tmp_path / "copy")
    assert [r.label for r in read_all([results[0], tmp_path / "copy"])] == [
        str(results[0]),
        str(tmp_path / "copy"),
    ]


def test_what_differs_is_named(results) -> None:
    first, second = read_all(results)
    settings = {**second.report.settings, "psnr": "another"}
    changed = replace(second.report, scene="elsewhere", settings=settings, views={"x": {}}, protocol="p")
    told = " ".join(disagreements([first, replace(second, report=changed)]))
    for part in (
        "scene differs: scene; elsewhere",
        "settings of psnr differ",
        "views differ",
        "protocol differs",
    ):
        assert part in told
    assert disagreements([first, first]) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["{better}"], "nothing to compare it with"),
        (["{better}", "{empty}"], "not evaluated yet (no metrics.json); run nmbg eval"),
        (["{better}", "{ssim}"], "no metric was measured on all"),
        (["{better}", "nowhere"], "no such folder"),
        (["{better}", "{worse}", "--split", "train"], "no metrics-train.json"),
    ],
)
def test_what_cannot_be_compared(results, tmp_path: Path, words: list[str], message: str) -> None:
    better, worse = results
    (tmp_path / "empty").mkdir()
    report = read_results(worse)
    write_results(tmp_path / "lpips", replace(report, mean={"lpips_vgg": 0.1}))
    named = {"better": better, "worse": worse, "empty": tmp_path / "empty", "ssim": tmp_path / "lpips"}
    output = tmp_path / "page.html"
    result = CliRunner().invoke(
        main, ["compare", *(w.format(**named) for w in words), "--output", str(output)]
    )
    assert result.exit_code == 2
    assert message in result.stderr
    assert not output.exists()


def test_the_command_writes_the_page(results, tmp_path: Path) -> None:
    output = tmp_path / "sub" / "page.html"
    result = CliRunner().invoke(main, ["compare", *map(str, results), "--output", str(output)])
    assert result.exit_code == 0, result.output
    assert output.is_file()
