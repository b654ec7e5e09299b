"""What a stress breaks is kept as a result."""

import importlib
import json
from pathlib import Path
from types import ModuleType

import pytest
from click.testing import CliRunner

from nmbg.errors import NmbgError


@pytest.fixture
def stability(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    return importlib.import_module("stability")


def test_what_is_refused_is_told_again_when_finished_runs_are_tabulated(
    stability: ModuleType, scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: object, jobs: object, split: bool) -> None:
        raise NmbgError("no face is left")

    monkeypatch.setattr(stability.Sweep, "measure", refuse)
    words = [str(scene_folder), "--presets", "photos", "--groups", "views", "--weights", str(tmp_path)]
    for finished in ([], ["--finished"]):
        output = tmp_path / "output"
        result = CliRunner().invoke(stability.main, [*words, "--output", str(output), *finished])
        assert result.exit_code == 0, result.output
        failed = json.loads((output / "stability-scene.json").read_text())["failed"]
        assert len(failed) > 1
        assert set(failed.values()) == {"NmbgError: no face is left"}
        assert all(f"- {key}: NmbgError: no face is left" in result.output for key in failed)
