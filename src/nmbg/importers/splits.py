"""Which views are held out."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from nmbg.errors import NmbgError


def every_nth(names: Sequence[str], n: int) -> list[str]:
    """Every n-th of the sorted names from the first on (index % n == 0); none for n = 0."""
    return sorted(names)[::n] if n > 0 else []


def read_split(path: Path, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Read a split file (docs/formats.md).

    Args:
        path: JSON {"test": [...], "train": [...]} with "train" optional, or text with one test image per
            line; an image is given by its name or by its 0-based place among the sorted names.
        names: the registered images.

    Returns:
        training and test names, each sorted; images in neither are left out of the scene.

    Raises:
        NmbgError: no such file, not a split, or images that are unknown or in both parts.
    """
    if not path.is_file():
        raise NmbgError(f"{path}: no such split file; give one with --split, or use --test-every")
    text = path.read_text()
    if path.suffix.lower() == ".json":
        try:
            parts = json.loads(text)
            listed, given_train = parts["test"], parts.get("train")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise NmbgError(f'{path}: not a split; expected {{"test": [names]}}, "train" optional') from error
    else:
        listed, given_train = [line.strip() for line in text.splitlines() if line.strip()], None
    test = _resolve(path, listed, names)
    train = sorted(set(names) - test) if given_train is None else sorted(_resolve(path, given_train, names))
    both = sorted(test.intersection(train))
    if both:
        raise NmbgError(f"{path}: {both[0]} is in both parts of the split; leave it in one")
    return train, sorted(test)


def _resolve(path: Path, listed: object, names: Sequence[str]) -> set[str]:
    if not isinstance(listed, list):
        raise NmbgError(f"{path}: not a split; expected lists of image names or 0-based indices")
    ordered = sorted(names)
    known = set(names)
    found = set()
    for item in listed:
        place = int(item) if str(item).isdigit() else -1
        if str(item) in known:
            found.add(str(item))
        elif 0 <= place < len(ordered):
            found.add(ordered[place])
        else:
            raise NmbgError(
                f"{path}: no registered image {item!r} among {len(ordered)} ({ordered[0]} … {ordered[-1]}); "
                "correct the split"
            )
    return found
