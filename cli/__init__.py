"""The command line `nmbg`: one module per command, imported only when that command is called."""

from __future__ import annotations

import errno
import importlib
import os
import signal
import sys
from types import FrameType
from typing import NoReturn

import click

from nmbg import __version__
from nmbg.allocator import keep_freed_memory
from nmbg.errors import NmbgError

# Threads that spin while they wait slow every step down severalfold when another program wants the cores.
# OpenMP reads this when torch loads it.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# Large tensors in huge pages, where the system has some: fewer faults. Torch reads this when it first
# allocates.
os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
keep_freed_memory()

COMMANDS = {
    "preprocess": "Turn a COLMAP workspace into a scene folder.",
    "train": "Train a scene.",
    "eval": "Render a run's held-out views and measure them.",
    "render": "Render a run along a camera path.",
    "compare": "Show several evaluated runs side by side.",
    "export": "Write a run in a compact form.",
    "demo": "Generate a small capture, train it and show held-out views.",
    "info": "Show versions, threads, devices and pretrained weights.",
}


class LazyGroup(click.Group):
    """A group that knows its commands by name; a command's module is imported when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, in the order in which one uses them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command's module, or None when there is no such command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"nmbg.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; a mistake of the user or of the file system ends in one line and exit code 2."""
        # Without this a terminated process would skip the clean-up of what is half-written.
        previous = signal.signal(signal.SIGTERM, _terminate)
        try:
            return super().invoke(ctx)
        except NmbgError as error:
            _fail(str(error))
        except BrokenPipeError:
            raise  # click's: the reader of our output has gone
        except OSError as error:
            _fail(_describe(error))
        except (KeyboardInterrupt, click.Abort):
            print("nmbg: interrupted", file=sys.stderr)
            sys.exit(128 + signal.SIGINT)
        finally:
            signal.signal(signal.SIGTERM, previous)


def _fail(message: str) -> NoReturn:
    print("nmbg: error:", " ".join(message.split()), file=sys.stderr)
    sys.exit(2)


def _describe(error: OSError) -> str:
    text = error.strerror or str(error) or type(error).__name__
    if error.errno == errno.ENOSPC:
        text += "; free some space and run it again"
    return text if error.filename is None else f"{error.filename}: {text}"


def _terminate(signum: int, frame: FrameType | None) -> NoReturn:
    sys.exit(128 + signum)


@click.group(
    cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.version_option(__version__, prog_name="nmbg")
def main() -> None:
    """Novel views of a real scene from ordinary photographs, by neural rendering of a mesh.

    \b
    Example: nmbg preprocess photos/dense out/room
             nmbg train out/room --output out/room-run --minutes 5
             nmbg eval out/room-run --metrics psnr ssim
    """
