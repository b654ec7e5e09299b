"""log.csv and TensorBoard events of a run."""

from __future__ import annotations

import csv
from pathlib import Path

from torch.utils.tensorboard.writer import SummaryWriter

COLUMNS = ("step", "seconds", "progress", "stage", "loss", "l1", "perceptual", "validation_psnr")


class Log:
    """Rows of figures, appended.

    Args:
        run: run folder.
        step: rows after this step are dropped: they belong to what a resumed run does again.
    """

    def __init__(self, run: Path, step: int) -> None:
        path = run / "log.csv"
        rows: list[list[str]] = []
        if step and path.exists():
            with path.open(newline="") as old:
                rows = [row for row in list(csv.reader(old))[1:] if int(row[0]) <= step]
        self._file = path.open("w", newline="")
        self._writer = csv.writer(self._file)
        self._writer.writerows([COLUMNS, *rows])
        self._events = SummaryWriter(str(run / "events"), purge_step=step or None)

    def write(self, step: int, **values: float) -> None:
        """Write one row; columns without a value stay empty."""
        row = {"step": step, **values}
        self._writer.writerow([_short(row.get(column, "")) for column in COLUMNS])
        self._file.flush()
        for name, value in values.items():
            self._events.add_scalar(name, value, step)

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self._events.close()


def _short(value: float | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
