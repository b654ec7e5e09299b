"""What a model is made of: one dataclass; every variant is a preset of it (nmbg.training.config)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelConfig:
    """The memory on the mesh, the photographs over it, and the network behind both.

    Args:
        degree: degree of the spherical harmonics, 0 to 2: (degree + 1)² coefficients a feature.
        features: features per vertex (paper: 8); without a U-Net three, colour.
        faces: rasterize the faces.
        points: rasterize the vertices as radius points.
        point_radius: where the short image side spans [−1, 1] (paper: 0.006); None: half a pixel (NPBG).
        point_weight: weight points by 1 − d² / r²; NPBG has none.
        layers: 1, or 2 for foreground and background, split at the foreground sphere.
        widths: channels of the U-Net per level (paper: 16, 32, 64, 128, 256), or with `sources` of the hidden
            layers of the network over the photographs, all at full resolution; empty: no network.
        supersample: s × s samples a pixel, averaged; with s > 1 the coarser levels are averages of the finest
            one instead of being rasterized anew. Faces only.
        sources: photographs blended in a pixel, over the colour on the mesh; 0 leaves them out. A network
            then reads what they and the mesh show, instead of the features.
    """

    degree: int = 2
    features: int = 8
    faces: bool = True
    points: bool = True
    point_radius: float | None = 0.006
    point_weight: bool = True
    layers: int = 1
    widths: tuple[int, ...] = (16, 32, 64, 128, 256)
    supersample: int = 1
    sources: int = 0

    def __post_init__(self) -> None:
        if not self.faces and not self.points:
            raise ValueError("a model rasterizes faces, points or both; got neither")
        if self.supersample not in (1, 2, 4, 8):
            raise ValueError(f"supersample: expected 1, 2, 4 or 8, got {self.supersample}")
        if self.supersample > 1 and self.points:
            raise ValueError("points have a radius in pixels and are not supersampled; leave one out")
        if not self.unet and (not self.faces or self.points or self.features != 3):
            raise ValueError("a model without a U-Net shows the colour of faces: 3 features, no points")
        if self.sources and self.layers > 1:
            raise ValueError("photographs add to the colour of one layer")

    @property
    def unet(self) -> bool:
        """Whether a U-Net turns features into colours; otherwise they are colours."""
        return bool(self.widths) and not self.sources

    @property
    def bases(self) -> int:
        """Spherical-harmonic coefficients per feature, (degree + 1)²."""
        return (self.degree + 1) ** 2

    @property
    def levels(self) -> int:
        """Levels of the image pyramid; 1 without a U-Net."""
        return len(self.widths) if self.unet else 1

    @property
    def rasterized_levels(self) -> int:
        """Levels that are rasterized; the rest are averages of the finest."""
        return 1 if self.supersample > 1 else self.levels

    @property
    def channels(self) -> int:
        """Channels of one layer's feature image."""
        return self.features * (int(self.faces) + int(self.points))

    def radius_px(self, width: int, height: int) -> float:
        """Point radius in pixels, the same at every level (paper, section 3.1)."""
        return 0.5 if self.point_radius is None else self.point_radius * min(width, height) / 2
