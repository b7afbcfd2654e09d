"""nuScenes' radar files: their fields, the states of a detection, and the form of an empty sweep."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

__all__ = ["NUSCENES_RADAR_STATES", "empty_sweep", "is_nuscenes_radar"]

# Of an example header in the development kit (RadarPointCloud.from_file); a sweep holds all of them.
_FLOATS = frozenset(("x", "y", "z", "rcs", "vx", "vy", "vx_comp", "vy_comp"))
_STATES = ("dyn_prop", "is_quality_valid", "ambig_state", "invalid_state", "pdh0")
_FIELDS = _FLOATS | {"id", *_STATES, "x_rms", "y_rms", "vx_rms", "vy_rms"}

NUSCENES_RADAR_STATES: MappingProxyType[str, Collection[int]] = MappingProxyType(
    {"invalid_state": (0,), "dyn_prop": tuple(range(7)), "ambig_state": (3,)}
)
"""States that the first versions of nuScenes' development kit keep: valid, not stopped, unambiguous; later ones keep
stopped detections (``dyn_prop`` 7) too."""


def is_nuscenes_radar(names: Iterable[str]) -> bool:
    """Check whether a PCD file with these fields is a radar sweep of nuScenes."""
    return set(names) >= _FIELDS


def empty_sweep(names: Iterable[str]) -> dict[str, npt.NDArray[np.float64]]:
    """One row of NaN: the development kit takes a NaN in the first row for an empty sweep, and no row for an error."""
    return {name: np.full(1, np.nan if name in _FLOATS else 0.0) for name in names}
