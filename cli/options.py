"""Options and argument types that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from nmbg.errors import NmbgError


class ExistingFolder(click.Path):
    """A folder that exists; otherwise one line that names it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Path of the folder.

        Raises:
            NmbgError: there is no such folder, or it is a file.
        """
        path = Path(value)
        if not path.is_dir():
            problem = "not a folder" if path.exists() else "no such folder"
            raise NmbgError(f"{path}: {problem}; check the path")
        return path


FOLDER = ExistingFolder()
NEW_FOLDER = click.Path(path_type=Path)

Decorator = Callable[[Callable[..., None]], Callable[..., None]]

weights_option: Decorator = click.option(
    "--weights",
    type=FOLDER,
    metavar="DIR",
    help="Folder with pretrained weights; without it, torch's hub cache.",
)
overwrite_option: Decorator = click.option("--overwrite", is_flag=True, help="Replace OUTPUT if it exists.")


def _resolve_device(ctx: click.Context, param: click.Parameter, name: str) -> str:
    import torch

    available = torch.cuda.is_available()
    if name == "cuda" and not available:
        raise NmbgError("--device cuda: torch sees no CUDA device; use --device cpu")
    return ("cuda" if available else "cpu") if name == "auto" else name


def _set_threads(ctx: click.Context, param: click.Parameter, threads: int | None) -> None:
    if threads is not None:
        import torch

        torch.set_num_threads(threads)


# The command receives "cpu" or "cuda".
device_option: Decorator = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    show_default=True,
    callback=_resolve_device,
    help="Where shading and the network run.",
)
threads_option: Decorator = click.option(
    "--threads",
    type=click.IntRange(min=1),
    callback=_set_threads,
    expose_value=False,
    help="CPU threads; without it, what torch finds.",
)


class VariadicOption(click.Option):
    """An option with a choice of words that takes several at once and may be repeated.

    `--metrics psnr ssim`, `--metrics psnr --metrics ssim` and `--metrics=psnr ssim` mean the same; the first
    word that is not one of the choices ends the list, so that an argument may follow.
    """

    def __init__(self, param_decls: Sequence[str], type: click.Choice[str], **options: Any) -> None:
        metavar = f"[{'|'.join(type.choices)}]..."
        super().__init__(param_decls, type=type, multiple=True, metavar=metavar, **options)
        self.words = tuple(type.choices)

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        """Let the parser see every word behind an option of its own, which click knows how to repeat."""
        super().add_to_parser(parser, ctx)
        parse = parser.parse_args
        parser.parse_args = lambda args: parse(args=self._repeated(args))

    def _repeated(self, args: list[str]) -> list[str]:
        repeated: list[str] = []
        option, count = "", 0  # the option whose list is open, and how many words it has
        for i, word in enumerate(args):
            if word == "--":
                return repeated + args[i:]
            if option and count and word in self.words:
                repeated.append(option)
            name, equals, _ = word.partition("=")
            if name in self.opts:
                option, count = name, len(equals)
            elif option and (not count or word in self.words):
                count += 1
            else:
                option = ""
            repeated.append(word)
        return repeated
