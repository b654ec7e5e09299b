"""Ways in which a scene, its cameras or its photographs can be worse than hoped, each by degrees."""

from stress.cameras import CAMERAS
from stress.geometry import GEOMETRY
from stress.mending import MENDING
from stress.model import MODEL
from stress.photographs import PHOTOGRAPHS
from stress.scenes import Stress, Stressed
from stress.views import VIEWS

STRESSES: dict[str, Stress] = {
    stress.name: stress for stress in (*VIEWS, *GEOMETRY, *CAMERAS, *PHOTOGRAPHS, *MENDING, *MODEL)
}

__all__ = ["STRESSES", "Stress", "Stressed"]
