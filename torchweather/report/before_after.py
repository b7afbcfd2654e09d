"""A page with a slider between a clear photograph and the same in several weathers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from torchweather import __version__
from torchweather.atmosphere.weather import Weather
from torchweather.camera.depth.scene_depth import CONFIDENCES
from torchweather.camera.tone import normalise, quantise, srgb_decode, srgb_encode
from torchweather.core.errors import InputTypeError, InputValueError, check_one_of
from torchweather.report import parts
from torchweather.report.page import write_report
from torchweather.report.pictures import jpeg_uri, png_uri
from torchweather.report.report import Report, Section
from torchweather.report.view_words import weather_words

__all__ = [
    "LONGEST_PX",
    "Comparison",
    "Panel",
    "comparisons_page",
    "panel_caption",
    "reduced",
    "write_before_after",
]

# Wider than a page shows, so that a zoom finds more; ten such pictures are 5 to 10 MB.
LONGEST_PX = 1600
# Streaks of one pixel survive it; at the figures' 84 they get a halo.
QUALITY = 90
# A small picture costs little exactly, and shows each pixel.
EXACT_BELOW_PX = 64 * 64

Panel = tuple[str, str, Tensor]
"""Title of a tab, caption, and picture ``(3, H, W)`` uint8."""


@dataclass(frozen=True)
class Comparison:
    """A clear picture and the same in several weathers.

    Args:
        title: heading, such as the file's name.
        clear: ``(3, H, W)`` uint8, sRGB.
        panels: the weathers, each of the same size.
        notes: sentences about what was guessed.
        alert: a sentence that stands above the picture; ``""`` for none.
    """

    title: str
    clear: Tensor
    panels: Sequence[Panel]
    notes: Sequence[str] = ()
    alert: str = ""

    def __post_init__(self) -> None:
        if not self.panels:
            raise InputValueError("Comparison: panels must hold one weather or more; got none.")
        for name, picture in (("clear", self.clear), *((title, picture) for title, _, picture in self.panels)):
            if not isinstance(picture, Tensor) or picture.dtype != torch.uint8:
                got = picture.dtype if isinstance(picture, Tensor) else type(picture).__name__
                raise InputTypeError(f"Comparison: {name} must be a uint8 tensor (3, H, W), sRGB; got {got}.")
            if picture.ndim != 3 or picture.shape[0] != 3 or picture.shape != self.clear.shape:
                raise InputValueError(
                    f"Comparison: {name} must have shape (3, H, W), all of one size; got {tuple(picture.shape)}, clear "
                    f"{tuple(self.clear.shape)}."
                )


def panel_caption(
    weather: Weather,
    *,
    seed: int,
    confidence: str,
    airlight: Sequence[float] | None = None,
    airlight_from: str = "guessed",
) -> str:
    """A caption with the weather, the confidence of the depth, the airlight and the seed.

    Args:
        weather: that was put on it.
        seed: of the weather.
        confidence: of the depth: ``exact``, ``measured``, ``completed`` or ``guessed``.
        airlight: linear signal of the sky that was used, red, green, blue; ``None`` where none was.
        airlight_from: where it comes from, such as ``given``, ``the frame's sky`` or ``guessed``.

    Example:
        >>> from torchweather.atmosphere.weather import Fog
        >>> panel_caption(Fog(mor_m=200.0), seed=7, confidence="guessed", airlight=(0.6, 0.61, 0.62))
        'Fog of 200 m visibility. Depth guessed. Airlight 0.60 0.61 0.62 of saturation (guessed). Seed 7.'
    """
    check_one_of("confidence", confidence, CONFIDENCES, owner="panel_caption")
    words = weather_words(weather)
    light = ""
    if airlight is not None:
        values = " ".join(f"{float(value):.2f}" for value in airlight)
        light = f" Airlight {values} of saturation ({airlight_from})."
    return f"{words[:1].upper()}{words[1:]}. Depth {confidence}.{light} Seed {seed}."


def reduced(image: Tensor, longest_px: int = LONGEST_PX) -> Tensor:
    """A picture whose longest side is at most ``longest_px``, averaged in linear light.

    Args:
        image: ``(3, H, W)`` uint8, sRGB.
        longest_px: pixels.

    Example:
        >>> reduced(torch.full((3, 300, 4000), 128, dtype=torch.uint8)).unique().tolist()
        [128]
    """
    height, width = size_within(image.shape[-2], image.shape[-1], longest_px)
    if (height, width) == tuple(image.shape[-2:]):
        return image
    linear = srgb_decode(normalise(image))[None]
    smaller = F.interpolate(linear, (height, width), mode="bilinear", antialias=True, align_corners=False)[0]
    return quantise(srgb_encode(smaller.clamp(0, 1)), torch.uint8)


def size_within(height: int, width: int, longest_px: int) -> tuple[int, int]:
    """Height and width of the same aspect, the longest at most ``longest_px``.

    Example:
        >>> size_within(3000, 4000, 1600), size_within(20, 30, 1600)
        ((1200, 1600), (20, 30))
    """
    scale = min(1.0, longest_px / max(height, width))
    return max(1, round(height * scale)), max(1, round(width * scale))


def comparisons_page(comparisons: Sequence[Comparison], *, lead: str = "") -> Report:
    """A page with one slider for each clear picture.

    Args:
        comparisons: pictures, one after another.
        lead: a sentence below the heading.
    """
    fine = f"""Drag the picture or the slider, or use the arrow keys: on the left of the line the photograph is as it
        was taken, on the right it is in the weather. Made by torchweather {__version__}."""
    first, *others = comparisons
    return Report(
        title=first.title,
        head=f"{first.title}: before and after",
        lead=[parts.Paragraph(lead, "lead")] if lead else [],
        sections=[
            Section("", _compared(first, 1)),
            *(Section(one.title, _compared(one, number)) for number, one in enumerate(others, start=2)),
            Section("", [parts.Fine(fine)]),
        ],
        styles=["slider.css"],
        scripts=["slider.js"],
    )


def _compared(comparison: Comparison, number: int) -> list[parts.Part]:
    """The slider of one picture, and what was assumed."""
    clear = reduced(comparison.clear)
    height, width = comparison.clear.shape[-2:]
    shown_height, shown_width = clear.shape[-2:]
    size = f"{width} × {height} px"
    if (shown_height, shown_width) != (height, width):
        size += f", shown at {shown_width} × {shown_height} px (the page holds {LONGEST_PX} px at most)"
    values = {
        "number": number,
        "title": comparison.title,
        "before": _uri(clear),
        "panels": [(title, caption, _uri(reduced(picture))) for title, caption, picture in comparison.panels],
        "size": size,
        "width": shown_width,
        "height": shown_height,
    }
    found: list[parts.Part] = [parts.Alert(comparison.alert, grave=True)] if comparison.alert else []
    found.append(parts.Widget("slider.html", values))
    if comparison.notes:
        found += [parts.Heading("What was assumed"), parts.Listing(comparison.notes)]
    return found


def write_before_after(
    path: str | os.PathLike[str],
    clear: Tensor,
    panels: Sequence[Panel],
    *,
    title: str = "Before and after",
    notes: Sequence[str] = (),
) -> None:
    """Write a self-contained page with a slider between a clear picture and the same in several weathers.

    Args:
        path: of the page; its folder must exist.
        clear: ``(3, H, W)`` uint8, sRGB.
        panels: ``(title, caption, picture)`` of each weather, such as ``("fog 200 m", caption, rgb)``; see
            ``panel_caption``. Pictures have the size of ``clear``.
        title: heading.
        notes: sentences about what was guessed.
    """
    write_report(comparisons_page([Comparison(title, clear, panels, notes)]), path)


def _uri(image: Tensor) -> str:
    picture = normalise(image)
    return png_uri(picture) if picture[0].numel() <= EXACT_BELOW_PX else jpeg_uri(picture, QUALITY)
