"""The command line of `nmbg eval`."""

import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

from nmbg.cli.eval import command
from nmbg.cli.options import VariadicOption


@pytest.fixture
def parsed(monkeypatch, tmp_path):
    """Run the command with `evaluate` replaced; return what it was called with, the run first."""
    (tmp_path / "run").mkdir()

    def run(arguments: str):
        calls = []

        def evaluate(*given):
            calls.append(given)

        monkeypatch.setattr("nmbg.evaluation.evaluate.evaluate", evaluate)
        monkeypatch.setattr("nmbg.evaluation.tables.metrics_table", lambda report: "table")
        with monkeypatch.context() as context:
            context.chdir(tmp_path)
            result = CliRunner().invoke(command, arguments.split())
        return result, (calls[0] if calls else None)

    return run


@pytest.mark.parametrize(
    ("arguments", "metrics"),
    [
        ("run", ("psnr", "ssim")),
        ("run --metrics psnr", ("psnr",)),
        ("run --metrics psnr ssim lpips", ("psnr", "ssim", "lpips")),
        ("--metrics psnr ssim lpips run", ("psnr", "ssim", "lpips")),
        ("--metrics psnr --metrics lpips run", ("psnr", "lpips")),
        ("run --metrics=ssim_svs psnr --threads 1", ("ssim_svs", "psnr")),
        ("--metrics psnr ssim --lpips-net vgg run --metrics lpips", ("psnr", "ssim", "lpips")),
        ("--metrics ssim_svs -- run", ("ssim_svs",)),
        ("--split train run --metrics ssim --device cpu", ("ssim",)),
    ],
)
def test_metrics_are_named_in_any_way(parsed, arguments, metrics):
    result, call = parsed(arguments)
    assert result.exit_code == 0, result.output
    assert call is not None
    assert str(call[0]) == "run"
    assert call[1] == metrics


def test_options_reach_evaluate(parsed, tmp_path):
    _, call = parsed(
        f"run --metrics lpips --lpips-net squeeze --weights {tmp_path} --split train --device cpu "
        "--table dtu65"
    )
    assert call is not None
    assert call[1:] == (("lpips",), "squeeze", tmp_path, "train", "cpu", "dtu65")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("run --metrics sharpness", "'sharpness' is not one of"),
        ("run --metrics psnr sharpness", "sharpness"),
        ("run --metrics", "requires an argument"),
        ("run --lpips-net resnet", "'resnet' is not one of"),
        ("run --split test2", "'test2' is not one of"),
        ("run --threads 0", "0 is not in the range"),
        ("--metrics psnr", "Missing argument 'RUN'"),
    ],
)
def test_wrong_usage_ends_with_2(parsed, arguments, message):
    result, call = parsed(arguments)
    assert result.exit_code == 2
    assert message in result.output
    assert call is None


def test_help_has_an_example_and_the_choices():
    result = CliRunner().invoke(command, ["--help"])
    assert result.exit_code == 0
    assert "[psnr|ssim|ssim_svs|lpips]..." in result.output
    assert "nmbg eval out/room-run --metrics psnr ssim lpips" in result.output


def test_help_does_not_import_torch():
    code = "import sys, nmbg.cli.eval; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_several_variadic_options_do_not_disturb_each_other():
    @click.command()
    @click.option("--fruit", cls=VariadicOption, type=click.Choice(("apple", "pear")))
    @click.option("--colour", "-c", cls=VariadicOption, type=click.Choice(("red", "green")))
    @click.argument("rest", nargs=-1)
    def pick(**chosen: tuple[str, ...]) -> None:
        click.echo(chosen)

    result = CliRunner().invoke(
        pick, ["--fruit", "apple", "pear", "red", "--colour", "red", "green", "-c", "red", "apple"]
    )
    assert result.output.strip() == str(
        {"fruit": ("apple", "pear"), "colour": ("red", "green", "red"), "rest": ("red", "apple")}
    )
