"""What one camera sees of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from nmbg.cameras import Camera
from nmbg.mesh import Mesh
from nmbg.ops import rasterize_faces


@dataclass(frozen=True)
class Sight:
    """What one camera sees of a mesh.

    Args:
        camera: the camera, at the size of the images below.
        face: [H, W] int32, the nearest face, −1 where none.
        depth: [H, W] float32 view-space z, scene units; 0 where the mesh is not seen.
    """

    camera: Camera
    face: Tensor
    depth: Tensor

    @property
    def covered(self) -> Tensor:
        """Where the mesh is seen, [H, W] bool."""
        return self.face >= 0


def look(mesh: Mesh, camera: Camera) -> Sight:
    """Rasterize the mesh for one camera, with depth."""
    faces = torch.from_numpy(mesh.faces)
    h = camera.project(torch.from_numpy(mesh.vertices))
    face, _, depth = rasterize_faces(h, faces, camera.height, camera.width)
    return Sight(camera, face, depth)
