"""Torch ops over the C++ kernels; reference.py holds their plain-torch twins, which are the specification."""

from nmbg.ops.adam import adam_rows
from nmbg.ops.blend import Blend, blend_photos, mip_chain
from nmbg.ops.gate import gate
from nmbg.ops.project import pixel_rays, project
from nmbg.ops.rasterize import (
    FaceHits,
    PointHits,
    rasterize_faces,
    rasterize_faces_pyramid,
    rasterize_points,
    rasterize_points_pyramid,
)
from nmbg.ops.shade import scatter_faces, shade_faces, shade_points

__all__ = [
    "Blend",
    "FaceHits",
    "PointHits",
    "adam_rows",
    "blend_photos",
    "gate",
    "mip_chain",
    "pixel_rays",
    "project",
    "rasterize_faces",
    "rasterize_faces_pyramid",
    "rasterize_points",
    "rasterize_points_pyramid",
    "scatter_faces",
    "shade_faces",
    "shade_points",
]
