"""Between weather and detector: a mosaic or an RGB image in the form that a detector takes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchweather.camera.tone import develop
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_one_of, check_positive

__all__ = ["ImageToDetector", "MosaicToImage"]

LAYOUTS = ("NCHW", "NHWC")
COLOURS = ("RGB", "BGR")
DTYPES = {"float32": torch.float32, "uint8": torch.uint8}


class ImageToDetector(nn.Module):
    """An sRGB image, scaled and normalised, in a detector's layout; exports to ONNX.

    ``(scale * picture - mean) / std`` with the picture in [0, 1].

    Args:
        layout: ``NCHW`` or ``NHWC``.
        colour: ``RGB`` or ``BGR``.
        dtype: ``float32`` or ``uint8`` (rounded and cut to 0..255).
        scale: 255 for detectors that take 0..255.
        mean, std: one number, or one a colour in the order of ``colour``.

    Example:
        >>> picture = ImageToDetector(colour="BGR", scale=255.0)
        >>> picture(torch.tensor([0.2, 0.4, 1.0]).view(1, 3, 1, 1)).flatten()
        tensor([255., 102.,  51.])
    """

    def __init__(
        self,
        *,
        layout: str = "NCHW",
        colour: str = "RGB",
        dtype: str = "float32",
        scale: float = 1.0,
        mean: float | Sequence[float] = 0.0,
        std: float | Sequence[float] = 1.0,
    ) -> None:
        check_arguments(
            "ImageToDetector(layout: str, colour: str, dtype: str, scale: float, mean: Quantity, std: Quantity)",
            layout,
            colour,
            dtype,
            scale,
            mean,
            std,
        )
        super().__init__()
        check_one_of("layout", layout, LAYOUTS, owner=self)
        check_one_of("colour", colour, COLOURS, owner=self)
        check_one_of("dtype", dtype, DTYPES, owner=self)
        check_positive("scale", scale, owner=self)
        self.layout, self.colour, self.dtype = layout, colour, dtype
        self.scale = float(scale)
        self.register_buffer("mean", torch.as_tensor(mean, dtype=torch.float32).reshape(-1, 1, 1))
        self.register_buffer("std", torch.as_tensor(std, dtype=torch.float32).reshape(-1, 1, 1))
        self.mean: Tensor
        self.std: Tensor
        check_positive("std", self.std, owner=self)
        for name, values in (("mean", self.mean), ("std", self.std)):
            if len(values) not in (1, 3):
                raise InputValueError(f"{type(self).__name__}: {name} must be one number or three; got {len(values)}.")

    def forward(self, image: Tensor) -> Tensor:
        """``(..., 3, H, W)`` sRGB in [0, 1] to ``(..., 3, H, W)`` or ``(..., H, W, 3)``."""
        return self.encoded(image)

    def encoded(self, rgb: Tensor) -> Tensor:
        """An sRGB picture ``(..., 3, H, W)`` in [0, 1] as the detector takes it."""
        ordered = rgb if self.colour == "RGB" else rgb.flip(-3)
        scaled = (ordered * self.scale - self.mean) / self.std
        placed = scaled if self.layout == "NCHW" else scaled.movedim(-3, -1)
        return placed.round().clamp(0.0, 255.0).to(torch.uint8) if self.dtype == "uint8" else placed


class MosaicToImage(ImageToDetector):
    """Demosaiced (Malvar), sRGB-encoded, scaled and normalised, in a detector's layout; exports to ONNX.

    ``(scale * picture - mean) / std`` with the picture in [0, 1].

    Args:
        pattern: of the mosaic, such as ``RGGB``.
        exposure: factor of the light before it is cut at saturation.
        layout, colour, dtype, scale, mean, std: as in ``ImageToDetector``.

    Example:
        >>> picture = MosaicToImage("RGGB", layout="NHWC", dtype="uint8", scale=255.0)
        >>> picture(torch.full((1, 1, 4, 6), 0.5)).shape
        torch.Size([1, 4, 6, 3])
    """

    def __init__(
        self,
        pattern: str = "RGGB",
        *,
        exposure: float = 1.0,
        layout: str = "NCHW",
        colour: str = "RGB",
        dtype: str = "float32",
        scale: float = 1.0,
        mean: float | Sequence[float] = 0.0,
        std: float | Sequence[float] = 1.0,
    ) -> None:
        check_arguments(
            "MosaicToImage(pattern: str, exposure: float, layout: str, colour: str, dtype: str, scale: float, "
            "mean: float | Sequence[float], std: float | Sequence[float])",
            pattern,
            exposure,
            layout,
            colour,
            dtype,
            scale,
            mean,
            std,
        )
        super().__init__(layout=layout, colour=colour, dtype=dtype, scale=scale, mean=mean, std=std)
        check_positive("exposure", exposure, owner=self)
        self.pattern, self.exposure = pattern, exposure

    def forward(self, signal: Tensor) -> Tensor:
        """``(..., 1, H, W)`` linear light to ``(..., 3, H, W)`` or ``(..., H, W, 3)``."""
        return self.encoded(develop(signal.clamp(0.0, 1.0), self.pattern, exposure=self.exposure))
