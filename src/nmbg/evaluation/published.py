"""The rows that the paper printed for its scenes, and how our setting differs from theirs.

Source: Neural Mesh-Based Graphics, its tables of Tanks and Temples and of DTU, with other methods' rows.
"""

from __future__ import annotations

import re
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nmbg.evaluation.results import Report
    from nmbg.scene import Scene

# The names in metrics.json of what the tables print: PSNR, SSIM, LPIPS × 100.
METRICS = ("psnr", "ssim_svs", "lpips_alex")

# Of each scene PSNR/SSIM/LPIPS.
_TANKS = """
LLFF             10.78/.454/60.62  8.98/.431/71.76   14.40/.578/53.93  9.15/.384/67.40
EVS              14.22/.527/43.52  7.41/.354/75.71   14.72/.568/46.85  10.54/.378/67.62
NeRF             20.85/.738/50.74  16.86/.701/60.89  21.55/.759/52.19  16.64/.627/64.64
NeRF++           22.77/.814/30.04  18.49/.747/43.06  22.93/.806/38.70  17.77/.681/47.75
FVS              22.93/.873/13.06  16.83/.783/30.70  22.28/.846/19.47  18.09/.773/24.74
SVS              23.86/.895/9.34   19.97/.833/20.45  23.72/.884/14.22  18.69/.820/15.73
NPBG             21.88/.877/15.04  12.35/.716/35.57  23.03/.876/16.65  18.08/.801/25.48
NMBG_(single)    23.88/.883/17.41  19.34/.810/24.13  23.38/.865/23.34  17.35/.788/23.66
NMBG_(full)      24.03/.888/16.84  19.54/.815/23.15  23.59/.870/22.72  17.78/.799/24.17
"""

# Of each scan PSNR, SSIM and LPIPS, each interpolation/extrapolation.
_DTU = """
LLFF             22.48/22.07 .935/.921 9.38/12.71   24.10/24.63 .900/.886 13.26/13.57  28.99/27.42 .928/.922 9.69/10.99
EVS              23.26/14.43 .942/.848 7.94/22.11   20.21/11.15 .902/.743 14.91/29.57  23.35/12.06 .928/.793 10.84/25.01
NeRF             32.00/28.12 .984/.963 3.04/8.54    34.45/30.66 .975/.957 7.02/10.14   37.36/31.66 .985/.967 4.18/6.92
FVS              30.44/25.32 .984/.961 2.56/7.17    32.96/27.56 .979/.950 2.96/6.57    35.64/29.54 .985/.963 1.95/6.31
SVS              32.13/26.82 .986/.964 1.70/5.61    34.30/30.64 .983/.965 1.93/3.69    37.27/31.44 .988/.967 1.30/4.26
NPBG             16.74/15.44 .889/.873 14.30/19.45  19.62/20.26 .847/.842 18.90/21.13  23.81/24.14 .867/.879 15.22/16.88
NMBG_(single)    26.78/20.85 .957/.925 9.64/12.91   29.98/25.40 .931/.909 12.75/13.70  31.43/26.52 .946/.931 11.73/11.13
NMBG_(full)      28.98/22.90 .970/.943 7.15/11.13   30.67/25.75 .939/.917 12.10/13.10  32.39/27.97 .956/.941 10.62/10.07
"""  # noqa: E501

# Views between the training cameras and beyond them, as indices into the views sorted by name.
DTU_PARTS = {"interpolation": (13, 14, 15, 23, 24, 25), "extrapolation": (0, 4, 38, 48)}


def dtu_parts(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Names of the held-out views of each part; none where others than DTU's are held out."""
    held_out = {i for i, view in enumerate(scene.views) if view.split == "test"}
    if held_out != {i for part in DTU_PARTS.values() for i in part}:
        return {}
    return {part: tuple(scene.views[i].name for i in indices) for part, indices in DTU_PARTS.items()}


@dataclass(frozen=True)
class Table:
    """Published results on one scene.

    Args:
        title: the scene.
        size: width and height of the images, pixels.
        parts: held-out views, as indices into the views sorted by name, under the name of each group.
        masked: whether estimate and photograph were multiplied by a mask.
        rows: method → per part PSNR, SSIM (range 2) and LPIPS (AlexNet) × 100.
    """

    title: str
    size: tuple[int, int]
    parts: dict[str, tuple[int, ...]]
    masked: bool
    rows: dict[str, dict[str, tuple[float, float, float]]]


def _tanks(column: int, title: str, *blocks: range) -> Table:
    rows = {}
    for line in _TANKS.split("\n")[1:-1]:
        method, *cells = line.split()
        psnr, ssim, lpips = map(float, cells[column].split("/"))
        rows[method.replace("_", " ")] = {"held out": (psnr, ssim, lpips)}
    held_out = tuple(i for block in blocks for i in block)
    return Table(f"Tanks and Temples, {title}", (978, 546), {"held out": held_out}, False, rows)


def _dtu(column: int, scan: int) -> Table:
    rows = {}
    for line in _DTU.split("\n")[1:-1]:
        method, *cells = line.split()
        metrics = [list(map(float, cell.split("/"))) for cell in cells[3 * column : 3 * column + 3]]
        rows[method.replace("_", " ")] = {
            part: (metrics[0][i], metrics[1][i], metrics[2][i]) for i, part in enumerate(DTU_PARTS)
        }
    return Table(f"DTU, scan {scan}", (1600, 1200), DTU_PARTS, True, rows)


TABLES = {
    "truck": _tanks(0, "Truck", range(172, 197)),
    "m60": _tanks(1, "M60", range(94, 130)),
    "playground": _tanks(2, "Playground", range(221, 253)),
    "train": _tanks(3, "Train", range(174, 195), range(227, 249)),
    "dtu65": _dtu(0, 65),
    "dtu106": _dtu(1, 106),
    "dtu118": _dtu(2, 118),
}


def recognise(scene: Scene) -> str | None:
    """The table of a scene, by the names of its folder and of what it was made from, or None.

    Of all names "train" is too common: it must stand in a path that speaks of Tanks and Temples.
    """
    path = f"{scene.source}/{scene.folder.name}".lower()
    scan = re.search(r"(?:dtu|scan)[ _-]*(\d+)", path)
    if scan:
        name = f"dtu{int(scan[1])}"
        return name if name in TABLES else None
    words = re.split(r"[^a-z0-9]+", path)
    tanks = "tanks" in words or "tat" in words
    return next((name for name in TABLES if name in words and (name != "train" or tanks)), None)


def our_rows(table: Table, report: Report, scene: Scene) -> dict[str, tuple[float | None, ...]]:
    """Our means in the table's units, per part; over all judged views where not all of a part were judged.

    Returns:
        part → PSNR, SSIM and LPIPS × 100, None for what was not measured.
    """
    judged = [i for i, view in enumerate(scene.views) if view.name in report.views]
    parts = table.parts if set(judged) == _held_out(table) else {"all judged views": tuple(judged)}
    rows: dict[str, tuple[float | None, ...]] = {}
    for part, indices in parts.items():
        values = [report.views[scene.views[i].name] for i in indices]
        means = [statistics.fmean(v[name] for v in values) if name in values[0] else None for name in METRICS]
        psnr, ssim, lpips = means
        rows[part] = (psnr, ssim, None if lpips is None else 100 * lpips)
    return rows


def differences(table: Table, name: str, report: Report, scene: Scene) -> list[str]:
    """Every difference between the setting of a table and ours, in words.

    Args:
        table: the published results.
        name: its name, a key of TABLES.
        report: our results.
        scene: our scene.
    """
    told = []
    if recognise(scene) != name:
        told.append(f"scene: theirs is {table.title}; ours is called {scene.folder.name}")
    judged = {i for i, view in enumerate(scene.views) if view.name in report.views}
    if judged != _held_out(table):
        told.append(
            f"views: theirs are {_counted(sorted(_held_out(table)))} of the views sorted by name, ours "
            f"{_counted(sorted(judged))}"
        )
    if report.split != "test":
        told.append("split: ours are training views")
    sizes = sorted({(v.camera.width, v.camera.height) for v in scene.views if v.name in report.views})
    if sizes != [table.size]:
        ours = ", ".join(f"{width}×{height}" for width, height in sizes)
        told.append(f"image size: theirs {table.size[0]}×{table.size[1]}, ours {ours}")
    masked = any(view.mask for view in scene.views if view.name in report.views)
    if masked != table.masked:
        told.append(f"masks: theirs {_with(table.masked)}, ours {_with(masked)}")
    missing = [metric for metric in METRICS if metric not in report.settings]
    if missing:
        told.append(
            f"not measured: {', '.join(missing)}; ask for --metrics psnr ssim_svs lpips --lpips-net alex"
        )
    told.append(f"geometry: theirs COLMAP's Delaunay mesh; ours {report.geometry}")
    told.append(
        "training: NMBG's 100 epochs on the scene, after 15 over other scenes where it says full; "
        f"ours {_trained(report)}"
    )
    return told


def _trained(report: Report) -> str:
    system = f"preset {report.preset}" if report.preset else report.run
    spent = "time not stated" if report.train_seconds is None else f"{report.train_seconds / 60:.3g} minutes"
    return f"{system}, {spent}"


def _held_out(table: Table) -> set[int]:
    return {i for indices in table.parts.values() for i in indices}


def _counted(indices: Sequence[int]) -> str:
    shown = ", ".join(map(str, indices[:12])) + (", …" if len(indices) > 12 else "")
    return f"{len(indices)} ({shown})"


def _with(masked: bool) -> str:
    return "with masks" if masked else "without"
