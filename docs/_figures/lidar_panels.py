"""Panels that several pictures of LiDAR effects share, the weather they are drawn in, and what they look at."""

from __future__ import annotations

from functools import partial

from effect_curves import Array, bins
from effect_panels import Lines
from lidar_frames import Beams
from lidar_statistics import intensity_ratio, lost_share, particle_count, particle_intensity

import torchweather as tw

CLEAR_AIR = tw.Rain(0.0)
RAIN, SNOW, LIGHT_SNOW = tw.Rain(25.0), tw.Snow(1.0), tw.Snow(0.1)
HAZE, MIST, FOG = tw.Fog(mor_m=500.0), tw.Fog(mor_m=200.0), tw.Fog(mor_m=100.0)

RATIO, PARTICLES, LOST = "intensity over clear air's, dB", "particle returns per m", "objects lost, %"
OBJECT_RANGE, PARTICLE_RANGE = "range of the object, m", "range of the particle, m"
counts = Lines(partial(particle_count, edges=bins(2, 20, 0.5)), PARTICLE_RANGE, PARTICLES, steps=True, zero=True)
brightness = Lines(
    partial(particle_intensity, edges=bins(2, 20, 1)), PARTICLE_RANGE, "particle intensity, photons", log=True
)
ratio_by_range = Lines(partial(intensity_ratio, axis="range_m", edges=bins(4, 46, 6)), OBJECT_RANGE, RATIO)
lost_by_margin = Lines(
    partial(lost_share, axis="margin_db", edges=bins(0, 16, 1)), "margin in clear air, dB", LOST, zero=True
)
ratio_by_margin = Lines(
    partial(intensity_ratio, axis="margin_db", edges=bins(0, 16, 1)),
    "margin in clear air, dB",
    RATIO,
    more={"ylim": (-5.0, 1.0)},
)


def margin_of(beams: Beams) -> Array:
    """Margin over the detection threshold in clear air, dB."""
    return beams.margin_db


def optical_depth_of(beams: Beams) -> Array:
    """Optical depth of the fog to the object, one way."""
    depth: Array = float(tw.LidarFog(FOG, beams.sensor).extinction_per_m) * beams.range_m
    return depth


def at_10_to_12_m(beams: Beams) -> Array:
    """Objects at nearly one range."""
    return (beams.range_m > 10.0) & (beams.range_m <= 12.0)


def bright(beams: Beams) -> Array:
    """Objects that no loss drawn here takes under the threshold."""
    return beams.margin_db > 7.0
