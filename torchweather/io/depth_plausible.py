"""Depths that no street has: evidence of a wrong encoding."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchweather.core.errors import TorchweatherError

__all__ = ["check_plausible"]

# Half of a street is never nearer to a vehicle's camera than its own bonnet, and no sensor of a vehicle measures
# farther than 500 m; sky, though, may be coded as the largest integer.
NEAREST_M, FARTHEST_M = 0.2, 500.0
# A float map may hold a renderer's far plane instead of sky; half of a street is never behind it.
MEDIAN_MOST_M = 1000.0
# The road before a vehicle's camera is within 20 m; of a street in centimetres the nearest 5 % are at 300 and more.
NEAR_SHARE, NEAR_MOST_M = 0.05, 100.0
# Medians of KITTI's LiDAR depth, frame by frame, are 8 to 16 m (13 frames); a map of the whole picture has more.
_USUAL_M = (1.0, 150.0)
_LIKELY = {"millimetre": 1e-3, "kitti": 1.0 / 256.0, "centimetre": 1e-2, "metre": 1.0}


def check_plausible(
    depth_m: Tensor, source: Path, encoding: str | None, *, code: Tensor | None = None, floats: bool = False
) -> None:
    """Raise where a depth map as a whole cannot be of a street.

    Args:
        depth_m: metres as read; NaN is unknown, ``inf`` is sky; neither counts.
        source: the file, for the error.
        encoding: by which it was read; ``None`` is float metres.
        code: the file's own numbers, from which other encodings are tried; ``None`` for disparity.
        floats: whether these were floats.

    Raises:
        TorchweatherError: the median is nearer than 0.2 m; or all of it is farther than 500 m (integers, disparity);
            or the median of a float map in metres is beyond 1000 m; or less than 5 % of a map that is not all alike is
            nearer than 100 m. It names the encodings that would give usual depths.
    """
    known = depth_m[torch.isfinite(depth_m)]
    if not known.numel():
        return
    median_m, nearest_m, farthest_m = (float(value) for value in (known.median(), known.min(), known.max()))
    floats_m = floats and encoding in (None, "metre")
    too_far = median_m > MEDIAN_MOST_M if floats_m else nearest_m > FARTHEST_M
    near_m = float(known.flatten().kthvalue(int(NEAR_SHARE * known.numel()) + 1).values)
    no_road = not too_far and near_m > NEAR_MOST_M and nearest_m < farthest_m
    if not too_far and not no_road and median_m >= NEAREST_M:
        return
    read_as = f"encoding {encoding!r}" if encoding else "float metres"
    found = f"{source}: read as {read_as}, depth is {nearest_m:.3g} to {farthest_m:.3g} m, median {median_m:.3g} m"
    wanted = "nearer than 0.2 m" if not too_far else f"farther than {MEDIAN_MOST_M if floats_m else FARTHEST_M:g} m"
    part = "half of it" if floats_m or not too_far else "all of it"
    if no_road:
        wanted, part = f"farther than {NEAR_MOST_M:g} m", f"{1 - NEAR_SHARE:.0%} of it"
    raise TorchweatherError(f"{found}; {part} is {wanted}, which no street has. {_advice(code, encoding, floats)}")


def _advice(code: Tensor | None, encoding: str | None, floats: bool) -> str:
    if code is None:
        return "Check fx (pixels of this map), the baseline (metres) and the unit of the disparity: pixels, or 1/256."
    median = float(code[torch.isfinite(code) & (code > 0)].median())
    likely = {
        name: median * step
        for name, step in _LIKELY.items()
        if name != (encoding or "metre") and _USUAL_M[0] <= median * step <= _USUAL_M[1]
    }
    if not likely:
        return "Depth up to scale has no metres: give a metric map, or the network itself (--depth-model)."
    first = " (divide by 256 first)" if floats else ""
    text = ", ".join(
        f"{name!r}{first if name == 'kitti' else ''} would give a median of {metres:.3g} m"
        for name, metres in likely.items()
    )
    return f"Likely encoding: {text}."
