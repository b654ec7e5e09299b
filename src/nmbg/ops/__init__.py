"""Torch ops over the C++ kernels; reference.py holds their plain-torch twins, which are the specification."""

from nmbg.ops.rasterize import face_depth, rasterize_faces, rasterize_points
from nmbg.ops.shade import shade_faces, shade_points

__all__ = ["face_depth", "rasterize_faces", "rasterize_points", "shade_faces", "shade_points"]
