"""log.csv and TensorBoard events of a run."""

from __future__ import annotations

import csv
from pathlib import Path

from torch.utils.tensorboard.writer import SummaryWriter

from nmbg.training import processes

COLUMNS = (
    *("step", "seconds", "progress", "stage", "scene", "loss", "l1", "perceptual", "adversarial"),
    *("adversarial_share", "discriminator", "validation_psnr"),
)


class Log:
    """Rows of figures, appended; written by the first of several processes alone.

    Args:
        run: run folder.
        step: rows after this step are dropped: they belong to what a resumed run does again.
    """

    def __init__(self, run: Path, step: int) -> None:
        self._first = processes.rank() == 0
        if not self._first:
            return
        path = run / "log.csv"
        rows: list[list[str]] = []
        if step and path.exists():
            with path.open(newline="") as old:
                rows = [row for row in list(csv.reader(old))[1:] if int(row[0]) <= step]
        self._file = path.open("w", newline="")
        self._writer = csv.writer(self._file)
        self._writer.writerows([COLUMNS, *rows])
        self._events = SummaryWriter(str(run / "events"), purge_step=step or None)

    def write(self, step: int, **values: float | str) -> None:
        """Write one row; columns without a value stay empty."""
        if not self._first:
            return
        row = {"step": step, **values}
        self._writer.writerow([_short(row.get(column, "")) for column in COLUMNS])
        self._file.flush()
        for name, value in values.items():
            if not isinstance(value, str):
                self._events.add_scalar(name, value, step)

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        if self._first:
            self._file.close()
            self._events.close()


def _short(value: float | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
