"""What a stress is: a scene made worse by a severity, the same for the same seed."""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nmbg.images import Image, write_image
from nmbg.scene import Scene, View
from nmbg.training.config import TrainConfig

Random = np.random.Generator


def unchanged(scene: Scene, severity: float, random: Random) -> Scene:
    """The scene as it is."""
    return scene


def file_name(name: str) -> str:
    """A stress's name as it stands in names of files."""
    return name.replace(",", "").replace(" ", "-")


def every_view(scene: Scene, severity: float) -> tuple[str, ...]:
    """Names of all held-out views."""
    return tuple(view.name for view in scene.test)


@dataclass(frozen=True)
class Stress:
    """One way in which things get worse; held-out views stay as they are, unless those around them tell.

    Args:
        name: in tables and on the command line.
        group: of stresses, on the command line.
        unit: what severities mean.
        severities: from none to hopeless; the first changes nothing.
        scene: scene, severity → scene.
        image: photograph, severity, place in the capture in [0, 1) → photograph of a training view.
        drifts: held-out photographs change alike, as photographs around them tell.
        config: training settings, severity → settings.
        presets: that it means something for; None for all.
        judged: scene, severity → names of the held-out views that are judged; none where the stress means
            nothing for the scene.
        mends: name of the stress whose damage is mended here; it is then the same damage.
    """

    name: str
    group: str
    unit: str
    severities: tuple[float, ...]
    scene: Callable[[Scene, float, Random], Scene] = unchanged
    image: Callable[[Image, float, float, Random], Image] | None = None
    drifts: bool = False
    config: Callable[[TrainConfig, float], TrainConfig] | None = None
    presets: tuple[str, ...] | None = None
    judged: Callable[[Scene, float], tuple[str, ...]] = every_view
    mends: str | None = None

    @property
    def changes(self) -> bool:
        """Whether the scene is another one."""
        return self.scene is not unchanged or self.image is not None

    @property
    def trains(self) -> bool:
        """Whether training is another one; else only other views are judged."""
        return self.changes or self.config is not None


@dataclass(frozen=True)
class Stressed:
    """A stress at a severity.

    Args:
        stress: the stress.
        severity: of its scale.
        seed: of what is random; severities of one seed are random alike.
    """

    stress: Stress
    severity: float
    seed: int = 0

    @property
    def key(self) -> str:
        """What it is kept under, beside the scene's name."""
        return f"{file_name(self.stress.name)}-{self.severity:g}-{self.seed}"

    def random(self) -> Random:
        """The same numbers for every severity."""
        name = self.stress.mends or self.stress.name
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    def apply(self, scene: Scene) -> Scene:
        """The scene, worse; its photographs are still the same."""
        return self.stress.scene(scene, self.severity, self.random())

    def photograph(self, scene: Scene, view: View) -> Image:
        """The photograph of one of the scene's views, [H, W, 3] uint8; worse, where it changes."""
        image = scene.load_image(view)
        if self.stress.image is None or not self._changes(view):
            return image
        random = np.random.default_rng([self.seed, zlib.crc32(view.name.encode())])
        place = scene.views.index(view) / len(scene.views)
        return self.stress.image(image, self.severity, place, random)

    def _changes(self, view: View) -> bool:
        """Whether a view's photograph is another one."""
        return self.stress.image is not None and (view.split == "train" or self.stress.drifts)

    def write(self, scene: Scene, folder: Path) -> Scene:
        """Write the worse scene into an empty folder."""
        worse = self.apply(scene)
        for kind in ("images", "masks"):
            (folder / kind).mkdir(parents=True, exist_ok=True)
        for view in worse.views:
            if view.mask is not None:
                shutil.copyfile(scene.folder / "masks" / view.mask, folder / "masks" / view.mask)
            if not self._changes(view):
                shutil.copyfile(scene.folder / "images" / view.image, folder / "images" / view.image)
        if self.stress.image is not None:
            changed = [view for view in worse.views if self._changes(view)]
            stored = {view.name: f"{Path(view.image).stem}.png" for view in changed}
            for view in changed:
                write_image(folder / "images" / stored[view.name], self.photograph(worse, view))
            views = tuple(replace(v, image=stored.get(v.name, v.image)) for v in worse.views)
            worse = replace(worse, views=views)
        worse = replace(worse, folder=folder)
        worse.save(folder)
        return worse
