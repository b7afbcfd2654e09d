"""SceneDepth: what is known of the way to every pixel's surface, and how surely."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_one_of

__all__ = ["COMPLETED", "CONFIDENCES", "EXACT", "GUESSED", "MEASURED", "SceneDepth", "least_sure"]

EXACT = "exact"
"""A renderer's buffer, or a map that the user vouches for."""
MEASURED = "measured"
"""A sensor measured almost every pixel: stereo, a dense LiDAR."""
COMPLETED = "completed"
"""A sensor measured some pixels; the others were filled in."""
GUESSED = "guessed"
"""No sensor: a model of the scene, or a network's scale-free answer."""
CONFIDENCES = (EXACT, MEASURED, COMPLETED, GUESSED)


@dataclass(frozen=True)
class SceneDepth:
    """Depth, sky and own vehicle of an image, and how sure they are.

    Args:
        depth_m: ``(..., 1, H, W)`` metres along the optical axis, more than 0; ``inf`` where the pixel is sky
            alone. A pixel that is sky in part has the depth of the surface in it. NaN is unknown.
        confidence: ``exact``, ``measured``, ``completed`` or ``guessed``.
        sky: ``(..., 1, H, W)`` share of each pixel that shows the sky, 0..1; ``None``: sky is where the depth is
            infinite.
        near_mask: ``(..., 1, H, W)`` share of each pixel that shows the own vehicle (bonnet, mirror, window frame),
            0..1; no weather lies in front of it. ``None``: nowhere.
        ground: ``(..., 1, H, W)`` probability that a pixel shows the ground, 0..1, where the depth is guessed and its
            normals with it; ``None``: the ground is what is level and low.
        horizon_row: row of the horizon at the principal point's column, pixels, where it was found in the picture.
        notes: sentences about what was guessed, for results and pages.

    Example:
        >>> scene = SceneDepth(torch.tensor([[[torch.inf, 20.0]]]), EXACT)
        >>> scene.sky_share
        tensor([[[1., 0.]]])
    """

    depth_m: Tensor
    confidence: str = EXACT
    sky: Tensor | None = None
    near_mask: Tensor | None = None
    ground: Tensor | None = None
    horizon_row: float | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_arguments(
            "SceneDepth(depth_m: Tensor, confidence: str, sky: Tensor | None, near_mask: Tensor | None, "
            "ground: Tensor | None, horizon_row: float | None, notes: Sequence)",
            self.depth_m,
            self.confidence,
            self.sky,
            self.near_mask,
            self.ground,
            self.horizon_row,
            self.notes,
        )
        check_one_of("confidence", self.confidence, CONFIDENCES, owner=self)
        for name in ("sky", "near_mask", "ground"):
            share = getattr(self, name)
            if share is not None and share.shape[-3:] != self.depth_m.shape[-3:]:
                raise InputValueError(
                    f"SceneDepth: {name} must have the depth's size {tuple(self.depth_m.shape)}; got "
                    f"{tuple(share.shape)}."
                )

    @property
    def sky_share(self) -> Tensor:
        """``(..., 1, H, W)`` share of each pixel that is sky, in the depth's dtype."""
        return torch.isinf(self.depth_m).to(self.depth_m.dtype) if self.sky is None else self.sky

    def of_sample(self, number: int) -> SceneDepth:
        """The scene of one sample of a batch ``(B, 1, H, W)``; what has no batch dimension is shared."""
        parts = {
            name: share[number] if share.ndim > 3 else share
            for name in ("depth_m", "sky", "near_mask", "ground")
            if (share := getattr(self, name)) is not None
        }
        return replace(self, **parts)

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> SceneDepth:
        """The same on another device or in another dtype."""
        moved = {
            name: share.to(device=device, dtype=dtype)
            for name in ("depth_m", "sky", "near_mask", "ground")
            if (share := getattr(self, name)) is not None
        }
        return replace(self, **moved)


def least_sure(*confidences: str) -> str:
    """The least sure of several.

    Example:
        >>> least_sure("measured", "guessed", "exact")
        'guessed'
    """
    return max(confidences, key=CONFIDENCES.index)
