"""One picture of a radar's frames side by side: range-Doppler maps above, points from above below."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.typing import NDArray
from torch import Tensor

from torchweather.radar.sensor import Radar
from torchweather.report.figures import INK, MUTED, STYLE
from torchweather.report.radar_figures import OTHER, above_uri, bar_uri, map_uri, power_scale
from torchweather.report.radar_views import RadarFrame

__all__ = ["radar_picture"]

DPI = 190  # of the figures, so that none is scaled
GAP_PX, TITLE_PX, HEADING_PX, FOOT_PX = 13, 84, 62, 62
POINTS_PER_PX = 72.0 / DPI


def radar_picture(title: str, frames: Sequence[tuple[str, RadarFrame]], boxes: Tensor, radar: Radar) -> bytes:
    """Frames of one scene beside each other, on the same scales.

    Args:
        title: of the picture.
        frames: heading and frame, the one that sets the scale of the maps first.
        boxes: outlines of road users, ``(K, 7)``: centre x, y, z, length, width, height, yaw.
        radar: the sensor.

    Returns:
        A PNG, 1280 pixels wide for two frames.
    """
    # Half of a map is noise; one cell in a thousand holds what stands out of it.
    map_dbm = power_scale(frames[0][1].power_dbm, 0.5, 0.999)
    of_scene = torch.cat([frame.points[frame.of_scene, 4] for _, frame in frames])
    points_dbm = power_scale(of_scene, 0.1, 0.9) if len(of_scene) else map_dbm
    columns = [
        (_pixels(map_uri(frame, radar, map_dbm)), _pixels(above_uri(frame, boxes, radar, points_dbm)))
        for _, frame in frames
    ]
    bars = [
        _pixels(bar_uri("map", map_dbm, "maps: mean power of the channels, dBm")),
        _pixels(bar_uri("points", points_dbm, "points of the scene: power, dBm")),
    ]
    column_px = columns[0][0].shape[1] + GAP_PX
    width = column_px * len(frames)
    height = TITLE_PX + HEADING_PX + sum(len(part) for part in (*columns[0], *bars)) + FOOT_PX + 4 * GAP_PX
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)

        def write(text: str, left: float, top: float, size_px: float, colour: str, weight: str = "normal") -> None:
            figure.text(
                left / width,
                1.0 - top / height,
                text,
                fontsize=size_px * POINTS_PER_PX,
                color=colour,
                weight=weight,
                va="center",
            )

        write(title, GAP_PX, TITLE_PX / 2, 27, INK, "bold")
        for k, ((heading, frame), parts) in enumerate(zip(frames, columns, strict=True)):
            left, top = k * column_px + GAP_PX // 2, TITLE_PX + HEADING_PX
            scene, other = int(frame.of_scene.sum()), int((~frame.of_scene).sum())
            whose = "noise" if frame.weather is None else "weather and noise"
            write(heading, left + 90, TITLE_PX + 14, 25, INK, "bold")
            write(f"{scene} points of the scene, {other} of {whose}", left + 90, TITLE_PX + 44, 21, MUTED)
            for part in parts:
                figure.figimage(part, left, height - top - len(part))
                top += len(part) + GAP_PX
        for bar in bars:
            figure.figimage(bar, (width - bar.shape[1]) // 2, height - top - len(bar))
            top += len(bar) + GAP_PX
        write("Orange:", GAP_PX, top + FOOT_PX / 2, 21, OTHER, "bold")
        says = "points of weather or noise. Rings: cells that became points. Triangle: the radar. Outlines: road users."
        write(says, GAP_PX + 112, top + FOOT_PX / 2, 21, MUTED)
        memory = io.BytesIO()
        figure.savefig(memory, format="png", metadata={"Software": None})
    return memory.getvalue()


def _pixels(uri: str) -> NDArray[np.float32]:
    """The picture in a data URI, ``(height, width, 4)``."""
    pixels: NDArray[np.float32] = imread(io.BytesIO(base64.b64decode(uri.partition(",")[2])), format="png")
    return pixels
