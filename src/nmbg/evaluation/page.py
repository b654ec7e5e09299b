"""Pages that hold everything they show: HTML without scripts, pictures as data URIs."""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt

from nmbg.images import resize, write_image

LONGER_SIDE = 480  # of a picture, pixels

_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>$title</title>
<style>
body { font: 15px/1.5 system-ui, "DejaVu Sans", Arial, sans-serif; color: #222; background: #fff;
       max-width: 1240px; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; margin-bottom: 0; }
h2 { font-size: 1.2rem; margin-top: 2.4rem; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
.wide { overflow-x: auto; }
th, td { padding: .2rem .8rem; text-align: right; border-bottom: 1px solid #eee; }
th { border-bottom: 1px solid #999; }
th:first-child, td:first-child, td.text, th.text { text-align: left; }
tr.ours, td.best { font-weight: bold; background: #f2f7ff; }
.row { display: flex; flex-wrap: wrap; gap: .6rem; margin: .6rem 0; }
figure { margin: 0; }
figure img { max-width: 100%; height: auto; display: block; background: #181818; outline: 1px solid #ccc; }
figcaption, .note { color: #555; font-size: .88rem; }
figcaption { width: 0; min-width: 100%; }
svg { max-width: 100%; height: auto; }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def page(title: str, *sections: str) -> str:
    """A whole HTML page, well-formed XML as well.

    Args:
        title: plain text.
        sections: HTML; empty ones are left out.
    """
    return _PAGE.substitute(title=escape(title), body="\n".join(part for part in sections if part))


def section(heading: str, *parts: str) -> str:
    """A heading and what stands below it."""
    return "\n".join(["<section>", f"<h2>{escape(heading)}</h2>", *parts, "</section>"])


def note(text: str) -> str:
    """A small paragraph of plain text."""
    return f'<p class="note">{escape(text)}</p>'


def listing(items: Sequence[str]) -> str:
    """A list of plain text."""
    return f'<ul class="note">{"".join(f"<li>{escape(item)}</li>" for item in items)}</ul>'


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    ours: Sequence[int] = (),
    best: Mapping[int, int] | None = None,
    text: bool = False,
) -> str:
    """A table of plain text.

    Args:
        head: headings of the columns.
        rows: cells; the first of each is set to the left, the others to the right.
        ours: rows that stand out.
        best: column → row of the cell that stands out.
        text: set all cells to the left.
    """
    best = best or {}
    kind = ' class="text"' if text else ""
    lines = ["".join(f"<th{kind}>{escape(cell)}</th>" for cell in head)]
    for r, row in enumerate(rows):
        kinds = [' class="best"' if best.get(c) == r else kind for c in range(len(row))]
        lines.append("".join(f"<td{k}>{escape(cell)}</td>" for k, cell in zip(kinds, row, strict=True)))
    marks = ["", *(' class="ours"' if r in ours else "" for r in range(len(rows)))]
    body = "\n".join(f"<tr{mark}>{line}</tr>" for mark, line in zip(marks, lines, strict=True))
    return f'<div class="wide"><table>\n{body}\n</table></div>'


def pictures(items: Sequence[tuple[str, npt.NDArray[np.uint8]]], longer: int = LONGER_SIDE) -> str:
    """Pictures beside one another, reduced to at most `longer` pixels a side, each with its caption.

    Args:
        items: caption in plain text, and [H, W, 3] or [H, W] uint8.
        longer: side of each at most, pixels.
    """
    return f'<div class="row">{"".join(_figure(caption, image, longer) for caption, image in items)}</div>'


def _figure(caption: str, image: npt.NDArray[np.uint8], longer: int) -> str:
    height, width = image.shape[:2]
    scale = longer / max(height, width)
    if scale < 1:
        image = resize(image, max(1, round(scale * width)), max(1, round(scale * height)))
    told = escape(caption)
    return (
        f'<figure><img src="{_data_uri(image)}" alt="{told}" width="{image.shape[1]}" '
        f'height="{image.shape[0]}"/><figcaption>{told}</figcaption></figure>'
    )


def _data_uri(image: npt.NDArray[np.uint8]) -> str:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "picture.jpg"
        write_image(file, image)
        return f"data:image/jpeg;base64,{base64.b64encode(file.read_bytes()).decode()}"
