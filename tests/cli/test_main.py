"""The command line: lazy, with help everywhere, and one line for every mistake."""

from __future__ import annotations

import errno
import importlib
import json
import os
import signal
import subprocess
import sys
import types
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import nmbg
from nmbg.cli import COMMANDS, main
from nmbg.errors import NmbgError


def install_command(monkeypatch: pytest.MonkeyPatch, error: BaseException | None) -> None:
    """Let `nmbg info` be a command that raises an error."""

    @click.command()
    def command() -> None:
        if error is not None:
            raise error

    module = types.ModuleType("nmbg.cli.info")
    module.__dict__["command"] = command
    monkeypatch.setitem(sys.modules, "nmbg.cli.info", module)


def test_help_and_version_answer_without_heavy_imports() -> None:
    code = (
        "import json, sys\nfrom nmbg.cli import main\n"
        "main(sys.argv[1:], standalone_mode=False)\nprint(json.dumps(sorted(sys.modules)))"
    )
    for option in ("--help", "--version"):
        done = subprocess.run(
            [sys.executable, "-c", code, option], capture_output=True, text=True, check=True
        )
        loaded = set(json.loads(done.stdout.splitlines()[-1]))
        assert not loaded & {"torch", "numpy", "pycolmap", "rich", "nmbg._core", "nmbg.cli.train"}


def test_version() -> None:
    assert CliRunner().invoke(main, ["--version"]).output == f"nmbg, version {nmbg.__version__}\n"


def test_help_lists_every_command() -> None:
    output = CliRunner().invoke(main, ["--help"]).output
    assert "Example: nmbg preprocess" in output
    for name, summary in COMMANDS.items():
        assert f"{name} " in output
        assert summary in output


@pytest.mark.parametrize("name", list(COMMANDS))
def test_help_of_a_command_ends_with_an_example(name: str) -> None:
    result = CliRunner().invoke(main, [name, "--help"])
    assert result.exit_code == 0
    assert f"nmbg {name} " in result.output.split("Example", 1)[1]


@pytest.mark.parametrize("name", list(COMMANDS))
def test_the_module_of_a_command_holds_it(name: str) -> None:
    assert isinstance(importlib.import_module(f"nmbg.cli.{name}").command, click.Command)


def test_an_unknown_command_is_refused() -> None:
    result = CliRunner().invoke(main, ["trian"])
    assert result.exit_code == 2
    assert "trian" in result.output


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (NmbgError("x.ply: no faces;\n mesh it"), "nmbg: error: x.ply: no faces; mesh it"),
        (
            OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "out/scene"),
            "nmbg: error: out/scene: No space left on device; free some space and run it again",
        ),
        (PermissionError(errno.EACCES, "Permission denied", "out"), "nmbg: error: out: Permission denied"),
        (OSError("connection lost"), "nmbg: error: connection lost"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, line: str
) -> None:
    install_command(monkeypatch, error)
    result = CliRunner().invoke(main, ["info"])
    assert result.exit_code == 2
    assert result.stderr == line + "\n"
    assert result.stdout == ""


@pytest.mark.parametrize("error", [KeyboardInterrupt(), click.Abort()])
def test_an_interruption_is_told_apart(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    install_command(monkeypatch, error)
    result = CliRunner().invoke(main, ["info"])
    assert result.exit_code == 128 + signal.SIGINT
    assert result.stderr == "nmbg: interrupted\n"


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    install_command(monkeypatch, ZeroDivisionError("bug"))
    with pytest.raises(ZeroDivisionError, match="bug"):
        CliRunner().invoke(main, ["info"], catch_exceptions=False)


def test_handlers_of_signals_are_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    install_command(monkeypatch, None)
    before = signal.getsignal(signal.SIGTERM)
    assert CliRunner().invoke(main, ["info"]).exit_code == 0
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.skipif(sys.platform == "win32", reason="has no such signals")
def test_a_terminated_process_cleans_up(tmp_path: Path) -> None:
    code = f"""
import sys, time, types, click
from pathlib import Path
from nmbg.atomic import atomic_folder
from nmbg.cli import main

@click.command()
def command():
    with atomic_folder(Path({str(tmp_path)!r}) / "scene") as folder:
        (folder / "half").write_text("half")
        print("ready", flush=True)
        time.sleep(60)

sys.modules["nmbg.cli.info"] = types.SimpleNamespace(command=command)
main(["info"])
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.terminate()
    assert process.returncode == 128 + signal.SIGTERM
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ["preprocess", "MISSING", "OUT"],
        ["train", "MISSING", "--output", "OUT"],
        ["eval", "MISSING"],
        ["info", "--weights", "MISSING"],
        ["demo", "OUT", "--weights", "MISSING"],
    ],
)
def test_a_folder_that_is_not_there_is_named(tmp_path: Path, words: list[str]) -> None:
    places = {"MISSING": str(tmp_path / "missing"), "OUT": str(tmp_path / "out")}
    result = CliRunner().invoke(main, [places.get(word, word) for word in words])
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
    assert places["MISSING"] in result.stderr
    assert list(tmp_path.iterdir()) == []
