"""A picture of where cameras stand, for a run folder."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nmbg.cameras import Camera
from nmbg.scene import Scene
from nmbg.training.artificial import Array, frame


def camera_picture(scene: Scene, drawn: Sequence[Camera], size: int = 480) -> str:
    """An SVG of the training cameras (grey) and drawn ones (red), from above and from the side.

    Args:
        scene: gives the training cameras, the sphere and the up axis.
        drawn: artificial cameras.
        size: side of each of the two pictures, pixels.
    """
    training = [view.camera for view in scene.train]
    right, up, forward = frame(scene.up)
    every = np.stack([camera.centre for camera in (*training, *drawn)])
    reach = 1.15 * max(scene.radius, float(np.linalg.norm(every - scene.centre, axis=1).max()))
    scale = size / (2 * reach)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * size}" height="{size + 24}" '
        'font-family="sans-serif" font-size="14">',
        f'<rect width="{2 * size}" height="{size + 24}" fill="white"/>',
    ]
    for panel, (name, axes) in enumerate((("from above", (right, -forward)), ("from the side", (right, up)))):
        corner = np.array([size * (panel + 0.5), size * 0.5 + 24])

        def at(point: Array, axes: tuple[Array, Array] = axes, corner: Array = corner) -> str:
            x, y = corner + scale * np.array([1, -1]) * [(point - scene.centre) @ axis for axis in axes]
            return f"{x:.1f} {y:.1f}"

        lines.append(f'<text x="{size * panel + 8}" y="41">{name}</text>')
        x, y = at(scene.centre).split()
        lines.append(f'<circle cx="{x}" cy="{y}" r="{scale * scene.radius:.1f}" fill="none" stroke="#ccc"/>')
        for colour, cameras in (("#555", training), ("#d22", drawn)):
            for camera in cameras:
                tip = camera.centre + 0.08 * reach * camera.axis
                lines.append(f'<path d="M {at(camera.centre)} L {at(tip)}" stroke="{colour}"/>')
                x, y = at(camera.centre).split()
                lines.append(f'<circle cx="{x}" cy="{y}" r="2.5" fill="{colour}"/>')
    legend = f"{len(training)} training cameras (grey), {len(drawn)} artificial ones (red)"
    lines.append(f'<text x="8" y="17">{legend}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"
