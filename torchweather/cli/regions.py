"""A region on the command line: ``x=0:60,y=-20:20,z=-2:5``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from torchweather.core.exceptions import InputValueError

if TYPE_CHECKING:
    from torchweather.metrics import Region

__all__ = ["REGION_HELP", "parse_region"]

REGION_HELP = (
    "leave out points beyond these coordinates, m, such as x=0:60,y=-20:20,z=-2:5; an axis that is not named, or a "
    "side that is empty (x=0:), has no bound"
)


def parse_region(text: str) -> Region:
    """The region that a text names.

    Args:
        text: ``AXIS=LOWEST:HIGHEST`` of x, y, z, joined by commas, metres; an empty side has no bound.

    Raises:
        ValueError: any other text.

    Example:
        >>> parse_region("x=0:28,z=-2:")
        Region(x_m=(0.0, 28.0), y_m=(-inf, inf), z_m=(-2.0, inf))
    """
    from torchweather.metrics import Region

    wrong = InputValueError(f"--region must be like x=0:60,y=-20:20,z=-2:5 (metres); got {text!r}.")
    limits: dict[str, tuple[float, float]] = {}
    for part in text.split(","):
        axis, _, sides = part.strip().partition("=")
        low, colon, high = sides.partition(":")
        name = f"{axis.strip().lower()}_m"
        if not colon or name not in ("x_m", "y_m", "z_m") or name in limits:
            raise wrong
        try:
            limits[name] = (float(low) if low.strip() else -math.inf, float(high) if high.strip() else math.inf)
        except ValueError:
            raise wrong from None
    return Region(**limits)
