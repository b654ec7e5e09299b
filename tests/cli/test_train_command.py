"""What `nmbg train` refuses before any work starts."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from nmbg.cli import main


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--photos", "0"], "--preset mesh"),
        (["--photos", "few"], "auto or all"),
        (["--preset", "mesh", "--photos", "4"], "blends no photographs"),
        (["--perceptual", "vgg19"], "without L_rec"),
        (["--minutes", "1", "--epochs", "1"], "one of iterations, epochs and minutes"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    scene_folder: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    out = tmp_path / "run"
    result = CliRunner().invoke(main, ["train", str(scene_folder), "--output", str(out), *words])
    assert result.exit_code == 2
    assert message in result.stderr
    assert not out.exists()
