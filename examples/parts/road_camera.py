"""A fixed highway camera in fog: its frames, the visibility meter's values, and the depth of the road.

Geometry of ``roadcam_fog``, from lane marks of 6 m, gaps of 9 m and lanes of 3.75 m: focal length 2104 px, horizon at
row 424, vanishing point of the lanes at column 1619, camera 2.2 m above the road. The depth of the road along the
optical axis is ``4566 / (row - 424)`` metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.ndimage import uniform_filter
from torch.nn.functional import avg_pool2d

import torchweather as tw
from torchweather.camera.bayer import mosaic
from torchweather.camera.tone import normalise, srgb_decode
from torchweather.gap.study.study import Study
from torchweather.io import read_image

__all__ = ["Block", "Morning", "blocks", "light_of", "local_extinction", "mornings", "road_depth_m", "study_of"]

WIDTH, HEIGHT, FOCAL_PX = 1470, 984, 2104.0
VANISHING_COLUMN, HORIZON_ROW = 1619.0, 424.0
DEPTH_TIMES_ROWS = 4566.0
TOP_ROW = 400  # of the study's frames: a little above the horizon
# The solid line beside the barrier leads from the vanishing point to row 748 of column 0; the margin keeps to asphalt.
EDGE_SLOPE, EDGE_MARGIN = (748.0 - HORIZON_ROW) / VANISHING_COLUMN, 14.0
FARTHEST_M = 140.0
# Air in front of far hills above the road's end: airlight in the direction in which the road is seen.
LIGHT_ROWS, LIGHT_COLUMNS = slice(330, 410), slice(900, 1440)
FRAMES_A_MORNING = 64
CLEAR_FROM_M, FOG_BELOW_M = 5000.0, 1000.0
BLOCK_FRAMES, LEAST_FRAMES, GAP_MINUTES = 8, 4, 15
# Local contrast: pixels less the mean of a window; cells of the depth between which its decay is fitted.
WINDOW_PX = 62
CELLS_M = (18.0, 20.0, 24.0, 29.0, 35.0, 42.0, 50.0, 60.0, 72.0)
LEAST_SLOPE = 0.02  # of the contrast of clear air

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Morning:
    """Frames of one morning and what the visibility meter read at each.

    Args:
        name: the date, such as ``20200222``.
        paths: of the frames, by time.
        meter_m: visibility, metres; 20,000 is the meter's ceiling.
    """

    name: str
    paths: tuple[Path, ...]
    meter_m: Array

    @property
    def day(self) -> int:
        """Day of the month."""
        return int(self.name[-2:])

    def minutes(self, place: int) -> int:
        """Time of a frame, minutes after midnight; its name ends in ``-08-04``."""
        hour, minute = self.paths[place].stem.split("-")[-2:]
        return 60 * int(hour) + int(minute)

    @property
    def clear(self) -> list[int]:
        """Places of the clear frames."""
        return [int(place) for place in np.flatnonzero(self.meter_m >= CLEAR_FROM_M)]


@dataclass(frozen=True)
class Block:
    """Frames in fog that follow each other.

    Args:
        name: date and time of the first, such as ``20200222-0801``.
        places: of its frames in the morning.
        meter_m: visibility whose extinction is the mean of the frames'.
        rel_sd: relative standard deviation of that mean, by the scatter of the frames' extinctions.
    """

    name: str
    places: tuple[int, ...]
    meter_m: float
    rel_sd: float


def mornings(folder: Path, every: int = 1) -> list[Morning]:
    """Mornings whose frames are in the folder; where half of a morning is kept, it is every second frame."""
    found = []
    for day in sorted((folder / "frames").iterdir()):
        paths = tuple(sorted(day.glob("*.jpg")))
        table = folder / "visibility" / f"Vis-{day.name[-2:]}-Feb-2020.mat"
        meter = loadmat(table)["vis_data"].ravel().astype(np.float64)
        step = len(meter) // max(len(paths), 1)
        if not paths or len(meter) != FRAMES_A_MORNING or len(meter[::step]) != len(paths):
            raise SystemExit(f"{day}: its {len(paths)} frames do not fit the {len(meter)} values of {table.name}")
        found.append(Morning(day.name, paths[::every], meter[::step][::every]))
    return found


def blocks(morning: Morning) -> list[Block]:
    """Frames below the meter's ``FOG_BELOW_M``, about eight at a time and no gap of more than 15 minutes within."""
    fog = np.flatnonzero(morning.meter_m <= FOG_BELOW_M)
    times = np.array([morning.minutes(int(place)) for place in fog])
    found = []
    for run in np.split(fog, np.flatnonzero(np.diff(times) > GAP_MINUTES) + 1):
        for part in np.array_split(run, max(1, round(len(run) / BLOCK_FRAMES))):
            if len(part) < LEAST_FRAMES:
                continue
            hour, minute = divmod(morning.minutes(int(part[0])), 60)
            loss = 1.0 / morning.meter_m[part]
            mean, deviation = float(np.mean(loss)), float(np.std(loss, ddof=1)) / len(loss) ** 0.5
            name = f"{morning.name}-{hour:02d}{minute:02d}"
            found.append(Block(name, tuple(int(k) for k in part), 1.0 / mean, min(deviation / mean, 1.0)))
    return found


def light_of(path: Path, shrink: int) -> Array:
    """Linear light of a frame, ``(3, H, W)``, means of ``shrink`` x ``shrink`` pixels.

    The camera's tone curve is not published; sRGB's is assumed.
    """
    image = normalise(read_image(path)[0])[:, :HEIGHT, :WIDTH]
    light: Array = avg_pool2d(srgb_decode(image)[None], shrink)[0].double().numpy()
    return light


def _grid(shape: tuple[int, ...], shrink: int) -> tuple[Array, Array]:
    """Rows and columns of the pixels' centres in the full frame."""
    rows, columns = (shrink * np.arange(size) + (shrink - 1) / 2 for size in shape[-2:])
    return np.broadcast_to(rows[:, None], shape[-2:]), np.broadcast_to(columns, shape[-2:])


def road_depth_m(shape: tuple[int, ...], shrink: int) -> tuple[Array, NDArray[np.bool_]]:
    """Depth along the optical axis and the pixels that are road, for frames of ``(H, W)``."""
    rows, columns = _grid(shape, shrink)
    depth = DEPTH_TIMES_ROWS / np.maximum(rows - HORIZON_ROW, 1.0)
    edge = HORIZON_ROW + EDGE_SLOPE * (VANISHING_COLUMN - columns) + EDGE_MARGIN
    return depth, (rows > edge) & (depth < FARTHEST_M)


def study_of(
    morning: Morning, fog: Sequence[Block], frames: Mapping[int, Array], clear: Sequence[Array], shrink: int
) -> Study:
    """A study of one morning: its blocks, with the light above the road's end as the measured airlight.

    Args:
        morning: whose frames these are.
        fog: blocks of it.
        frames: light by the frame's place.
        clear: light of clear frames.
        shrink: of the frames.
    """
    first, shape = TOP_ROW // shrink, clear[0].shape
    rows, columns = (size - size % 2 for size in (shape[1] - first, shape[2]))
    depth, road = road_depth_m(shape, shrink)
    camera = tw.Camera.from_intrinsics(
        FOCAL_PX / shrink, FOCAL_PX / shrink, (shape[2] - 1) / 2, (shape[1] - 1) / 2 - first, columns, rows
    )

    def frame(light: Array) -> dict[str, NDArray[np.float32]]:
        raw = mosaic(torch.from_numpy(light[:, first : first + rows, :columns]), camera.bayer_pattern)
        return {"bayer": raw[0].clamp(0.0, 1.0).float().numpy()}

    def part(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return values[first : first + rows, :columns]

    above = (slice(None), _shrunk(LIGHT_ROWS, shrink), _shrunk(LIGHT_COLUMNS, shrink))
    conditions = []
    for block in fog:
        light = np.mean([frames[place][above].mean((1, 2)) for place in block.places], axis=0)
        conditions.append(
            {
                "id": block.name,
                "scene": morning.name,
                "weather": tw.Fog(mor_m=round(block.meter_m)),
                "rel_sd": block.rel_sd,
                "frames": [frame(frames[place]) for place in block.places],
                "airlight": tuple(float(value) for value in light),
                "time_s": [60.0 * morning.minutes(place) for place in block.places],
            }
        )
    geometry = {"depth_m": part(np.minimum(depth, 1e4)), "mask": part(~road).astype(np.uint8)}
    scene = {"id": morning.name, "clear": [frame(light) for light in clear], "geometry": geometry}
    return Study.from_arrays(sensor=camera, scenes=[scene], conditions=conditions)


def _shrunk(pixels: slice, shrink: int) -> slice:
    return slice(pixels.start // shrink, pixels.stop // shrink)


def local_extinction(frames: Sequence[Array], clear: Sequence[Array], shrink: int) -> Array:
    """Extinction of each frame by the local contrast of the road, 1/m; NaN where too little is seen.

    Pixels less the mean of a window around them hold lane marks, seams and edges, and neither airlight nor a slow
    change of light. In cells of one depth they are regressed on those of the clear frames; the slope is the exposure
    gain times the transmission, and its logarithm falls over the depth by the extinction.

    Args:
        frames: green light ``(H, W)`` in fog.
        clear: green light in clear air.
        shrink: of the frames.
    """
    depth, road = road_depth_m(clear[0].shape, shrink)
    cells = [road & (depth >= low) & (depth < high) for low, high in pairwise(CELLS_M)]
    before = _contrast(np.median(clear, axis=0), shrink)
    middle = np.array([depth[cell].mean() for cell in cells])
    found = []
    for frame in frames:
        now = _contrast(frame, shrink)
        slope = np.array([(now[cell] * before[cell]).sum() / (before[cell] ** 2).sum() for cell in cells])
        seen = slope > LEAST_SLOPE
        found.append(-np.polyfit(middle[seen], np.log(slope[seen]), 1)[0] if seen.sum() >= 4 else np.nan)
    return np.array(found)


def _contrast(light: Array, shrink: int) -> Array:
    contrast: Array = light - uniform_filter(light, WINDOW_PX // shrink)
    return contrast
