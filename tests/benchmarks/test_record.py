"""How benchmarks begin and end."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def run(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(BENCHMARKS / script), *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("script", ["shading.py", "blend.py"])
def test_a_wrong_path_ends_in_one_line(script: str, tmp_path: Path) -> None:
    output = tmp_path / "tables"
    ended = run(script, str(tmp_path / "nowhere"), "--output", str(output))
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert str(tmp_path / "nowhere") in line
    assert not output.exists()


def test_what_no_user_did_keeps_its_trace() -> None:
    code = f"import sys; sys.path.insert(0, {str(BENCHMARKS)!r}); import record; 1 / 0"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "Traceback" in ended.stderr
