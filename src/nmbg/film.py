"""Frames of a camera path, as numbered pictures or as a video."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

from nmbg.atomic import atomic_file, atomic_folder
from nmbg.cameras import Camera
from nmbg.errors import NmbgError
from nmbg.images import Image, to_bytes, write_image
from nmbg.model.renderer import Renderer
from nmbg.progress import progress_bar

VIDEO = ".mp4"


def film(
    renderer: Renderer, path: Sequence[Camera], output: Path, fps: float, overwrite: bool = False
) -> None:
    """Render a path.

    Args:
        renderer: the model.
        path: cameras of equal size.
        output: a file NAME.mp4 for a video, else a folder, which gets 0000.png and so on.
        fps: frames a second of a video.
        overwrite: replace what stands there.

    Raises:
        NmbgError: `output` exists and may not be replaced, or a video cannot be written here.
    """
    if output.suffix != VIDEO:
        digits = max(4, len(str(len(path) - 1)))
        with atomic_folder(output, overwrite) as folder:
            for i, image in enumerate(_frames(renderer, path)):
                write_image(folder / f"{i:0{digits}}.png", image)
        return
    if output.exists() and not overwrite:
        raise NmbgError(f"{output}: exists; use --overwrite or another name")
    _write_video(output, _frames(renderer, path), path[0], fps)


def _frames(renderer: Renderer, path: Sequence[Camera]) -> Iterator[Image]:
    """Renders, [H, W, 3] uint8."""
    with progress_bar() as bar:
        for camera in bar.track(path, description="rendering"):
            yield to_bytes(renderer.render(camera))


def _write_video(output: Path, frames: Iterator[Image], camera: Camera, fps: float) -> None:
    """Write H.264, whose sides are even: an odd last row or column is left out."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise NmbgError(f"{output}: videos need ffmpeg: pip install 'nmbg[video]'") from error
    width, height = camera.width // 2 * 2, camera.height // 2 * 2
    with (
        atomic_file(output) as file,
        closing(
            imageio_ffmpeg.write_frames(str(file), (width, height), fps=fps, quality=8, macro_block_size=1)
        ) as writer,
    ):
        writer.send(None)
        for frame in frames:
            writer.send(frame[:height, :width].copy())
