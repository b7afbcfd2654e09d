"""Colour spaces of the image scores."""

from __future__ import annotations

from torch import Tensor

__all__ = ["luma", "mixed", "yiq"]

# ITU-R BT.601
LUMA = (0.299, 0.587, 0.114)
# NTSC 1953, as MATLAB's rgb2ntsc has it to three digits
YIQ = ((0.299, 0.587, 0.114), (0.5959, -0.2746, -0.3213), (0.2115, -0.5227, 0.3112))


def mixed(image: Tensor, rows: tuple[tuple[float, ...], ...]) -> Tensor:
    """Linear combinations of the channels: ``(B, 3, H, W)`` to ``(B, len(rows), H, W)``."""
    matrix = image.new_tensor(rows)
    found: Tensor = (matrix @ image.flatten(2)).reshape(len(image), len(rows), *image.shape[2:])
    return found


def luma(image: Tensor) -> Tensor:
    """Brightness ``(B, 1, H, W)`` of a colour image; a grey one stays."""
    return image if image.shape[1] == 1 else mixed(image, (LUMA,))


def yiq(image: Tensor) -> Tensor:
    """``(B, 3, H, W)``: luma and two differences of colour."""
    return mixed(image, YIQ)
