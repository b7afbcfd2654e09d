"""A departure that no effect explains: as a curve in natural units, and as a stage that copies it.

Statistics are compared in units in which their scatter is even (``frame_statistics.py``); here they go back to shares,
counts a frame, metres and logarithms of intensity, are averaged over the conditions with their weights, and become the
curve of an ``Empirical`` stage where a stage can copy them.

References:
    GAP.md 3 (9). Widening of an average whose parts disagree: Particle Data Group, Review of Particle Physics, 5.2.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.statistics.counting import ANSCOMBE
from torchweather.gap.statistics.formula import bounded
from torchweather.gap.statistics.frame_statistics import Group, Layout
from torchweather.gap.statistics.log_square import spread_of_log_square
from torchweather.lidar.effects.empirical import Empirical

__all__ = ["Departures", "NaturalCurve", "empirical_stage", "natural_curve"]

Floats = NDArray[np.float64]

CENTRAL_90 = 1.6449  # standard deviations of a normal law
UNITS = {
    "share": "share of beams",
    "count": "returns per frame",
    "between": "difference of ln(standard deviation from frame to frame)",
    "slope": "change from the first frame to the last",
    "persistence": "root of the returns that stay in their place",
}
UNIT_OF = {
    "log_intensity_ratio": "ln(intensity ratio)",
    "log_particle_intensity": "ln(intensity ratio)",
    "log_intensity_spread": "standard deviation of ln(intensity)",
    "log_particle_intensity_spread": "standard deviation of ln(intensity)",
    "range_residual_m": "m",
    "range_residual_spread": "m, standard deviation",
    "clustered_share": "share of particle returns",
    **dict.fromkeys(("lost_target_share", "lost_flickering_share", "speed_far_off_share"), "share of targets"),
    **{f"repeated_{what}_share": "share of targets" for what in ("power", "range", "speed")},
    "noise_floor_share": "share of frames",
    **dict.fromkeys(("clutter_count", "ghost_count"), "detections per frame"),
    **{f"{side}_share_{where}": "share of cells" for side in ("bright", "dark") for where in ("near", "far")},
    "lone_pixel_map": "root of the pixels that stand out in every frame",
}
COPIED = {
    "log_intensity_ratio": ("intensity", "object"),
    "log_particle_intensity": ("intensity", "particle"),
    "log_intensity_spread": ("intensity_noise", "object"),
    "log_particle_intensity_spread": ("intensity_noise", "particle"),
    "range_residual_m": ("range", "object"),
    "range_residual_spread": ("range_noise", "object"),
    "lost_share": ("loss", "object"),
    "new_share": ("returns", "object"),
    "particles_before_objects": ("returns", "object"),
    "new_share_of_empty_beams": ("returns", "empty"),
    "particles_of_empty_beams": ("returns", "empty"),
}
"""Statistic to the kind of an ``Empirical`` stage, and of what."""
WHY_NOT = {
    "between": "frames differ more or less from one another than simulated ones; a curve over an axis is the same in "
    "every frame",
    "slope": "it changes from the first frame to the last, and a stage does not know when a frame was taken",
    "persistence": "returns stay in their place from frame to frame; a stage draws each frame anew",
    "clustered_share": "it is about returns with neighbours; a curve acts on each beam alone",
    "lost_share_of_thin_targets": "it is about thin targets, which are told by their neighbours; a curve acts on each "
    "beam alone",
    "lone_pixel_map": "single pixels stand out in every frame; a curve acts on all pixels alike",
    "beyond_share": "returns behind the surface: no statistic tells how far behind",
}
FEWER_RETURNS = "there are fewer such returns than simulated; taking them away would need to know what stands behind"
LESS_SCATTER = "the measurement scatters less than the simulation; a stage can add noise, not take it away"


@dataclass(frozen=True)
class Departures:
    """Measured conditions beside their simulation, entry by entry.

    Args:
        layout: of the vectors.
        measured, simulated, sd: ``(C, P)`` vectors, simulated means, and scatter of a departure.
        used: ``(C, P)`` entries that count.
        frames: ``(C,)`` measured frames.
        weight: ``(C, bins)`` weight in each bin a frame, of the entries that come from sums over bins.
        clear_spread: statistic to ``(C,)``, the standard deviation of clear frames in which its spread is told
            (``log_square.py``); others tell ln(standard deviation).
    """

    layout: Layout
    measured: Floats
    simulated: Floats
    sd: Floats
    used: NDArray[np.bool_]
    frames: NDArray[np.intp]
    weight: Floats
    clear_spread: Mapping[str, Floats]

    def place(self, statistic: str, axis: str) -> slice | None:
        """Where a group stands in the vectors; ``None`` where there is none."""
        for group, part in zip(self.layout.groups, self.layout.slices, strict=True):
            if (group.statistic, group.axis) == (statistic, axis):
                return part
        return None


@dataclass(frozen=True)
class NaturalCurve:
    """Measured less simulated along an axis, in natural units, averaged over the conditions.

    Args:
        edges: ``(bins + 1,)``.
        value, sd: ``(bins,)``; NaN where nothing counts.
        unit: of the value, in words.
    """

    edges: tuple[float, ...]
    value: Floats
    sd: Floats
    unit: str

    @property
    def low(self) -> Floats:
        """Lower end of the central 90 %."""
        return self.value - CENTRAL_90 * self.sd

    @property
    def high(self) -> Floats:
        """Upper end."""
        return self.value + CENTRAL_90 * self.sd


def natural_curve(departures: Departures, group: Group) -> NaturalCurve:
    """A group's departure in natural units.

    Args:
        departures: of all conditions.
        group: one of the layout's.
    """
    value, sd = _averaged(departures, group, _natural(group, departures))
    return NaturalCurve(group.edges, value, sd, UNIT_OF.get(group.statistic) or UNITS.get(group.kind, group.statistic))


def empirical_stage(departures: Departures, group: Group) -> Empirical | str:
    """The stage that copies a group's departure, or why none can, in words.

    Args:
        departures: of all conditions.
        group: one of the layout's.
    """
    reason = WHY_NOT.get(group.statistic) or WHY_NOT.get(group.kind)
    if reason is not None:
        return reason
    if group.statistic not in COPIED:
        return f"no stage acts on {group.statistic}"
    kind, of = COPIED[group.statistic]
    if kind == "returns":
        return _returns(departures, group, of)
    if kind == "loss":
        return _along(group, _lost(departures, group), kind, of)
    if kind.endswith("noise"):
        spread = _natural(group, departures)
        value, sd = _averaged(departures, group, lambda entry: spread(entry) ** 2)
        if not (value > sd).any():
            return LESS_SCATTER
        return _along(group, np.sqrt(np.maximum(value, 0.0)), kind, of)
    return _along(group, natural_curve(departures, group).value, kind, of)


def _natural(group: Group, departures: Departures) -> Callable[[Floats], Floats]:
    """From an entry's even units to natural ones."""
    kind, frames = group.kind, departures.frames
    clear = departures.clear_spread.get(group.statistic)
    if clear is not None:
        return lambda entry: spread_of_log_square(entry) * clear[:, None]
    if kind == "share":
        return lambda entry: np.sin(np.clip(entry, 0.0, 0.5 * math.pi)) ** 2
    if kind == "count":
        return lambda entry: (np.maximum(entry, 0.0) ** 2 - ANSCOMBE) / frames[:, None]
    if kind == "spread":
        return np.exp
    return lambda entry: entry


def _averaged(departures: Departures, group: Group, natural: Callable[[Floats], Floats]) -> tuple[Floats, Floats]:
    """Weighted mean over the conditions of measured less simulated, ``(bins,)``, and its standard deviation.

    Where conditions differ by more than their scatter, as an effect that grows with the rate does, the error widens.
    """
    part = departures.place(group.statistic, group.axis)
    assert part is not None
    measured, simulated, scatter = (one[:, part] for one in (departures.measured, departures.simulated, departures.sd))
    used = departures.used[:, part]
    apart = natural(measured) - natural(simulated)
    sd = 0.5 * (natural(simulated + scatter) - natural(simulated - scatter))
    weight = np.where(used & (sd > 0), 1.0 / np.where(sd > 0, sd, 1.0) ** 2, 0.0)
    total, count = weight.sum(0), (weight > 0).sum(0)
    known = total > 0
    some = np.where(known, total, 1.0)
    mean = (weight * apart).sum(0) / some
    disagreement = (weight * (apart - mean) ** 2).sum(0) / np.maximum(count - 1, 1)
    error = np.sqrt(np.maximum(disagreement, 1.0) / some)
    return np.where(known, mean, np.nan), np.where(known, error, np.nan)


def _level(departures: Departures, group: Group) -> Floats:
    """Simulated share, ``(bins,)``, mean over the conditions."""
    part = departures.place(group.statistic, group.axis)
    assert part is not None
    found: Floats = _natural(group, departures)(departures.simulated[:, part]).mean(0)
    return found


def _lost(departures: Departures, group: Group) -> Floats:
    """Probability that a return is dropped, or below 0 that a lost one comes back."""
    more, level = natural_curve(departures, group).value, _level(departures, group)
    dropped = more / np.maximum(1.0 - level, 1e-6)
    back = more / np.maximum(level, 1e-6)
    found: Floats = np.clip(np.where(more > 0, dropped, back), -1.0, 1.0)
    return found


def _returns(departures: Departures, group: Group, of: str) -> Empirical | str:
    """Added returns: how many, and where."""
    counted = "particles_before_objects" if of == "object" else "particles_of_empty_beams"
    places, per_beam, sure = _places(departures, counted, of)
    if not sure.any() or per_beam.sum() <= 0:
        return FEWER_RETURNS
    per_beam = np.where(sure, per_beam, 0.0)
    if group.statistic == counted:
        chance = min(float(per_beam.sum()), 1.0)
        return Empirical("returns", "every_beam", [0.0], [chance], 0.0, 0.0, of, list(places), list(per_beam))
    curve, level = natural_curve(departures, group), _level(departures, group)
    if not (curve.value > curve.sd).any():
        return FEWER_RETURNS
    value = curve.value / np.maximum(1.0 - level, 1e-6)
    if of == "object":
        value = value / _in_front(departures, group, places, per_beam / per_beam.sum())
    return _along(group, np.clip(value, 0.0, 1.0), "returns", of, list(places), list(per_beam))


def _places(departures: Departures, counted: str, of: str) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Ranges of added returns: edges, probability of each for a beam that sees past it, and where it is plain."""
    (group,) = [one for one in departures.layout.groups if one.statistic == counted]
    curve, edges = natural_curve(departures, group), bounded(group.edges)
    more = np.nan_to_num(curve.value)
    if of == "object":
        ends, beams = _beams(departures, "new_share", "range_m")
        middle, surface = 0.5 * (edges[1:] + edges[:-1]), 0.5 * (ends[1:] + ends[:-1])
        past = np.array([beams[surface > one].sum() for one in middle])
    else:
        _, beams = _beams(departures, "new_share_of_empty_beams", "azimuth_rad")
        past = np.full(len(more), beams.sum())
    # Fewer than a beam in front of which a return could be says nothing.
    per_beam = np.where(past >= 1.0, more / np.maximum(past, 1.0), 0.0)
    return edges, per_beam, (per_beam > 0) & (more > np.nan_to_num(curve.sd))


def _beams(departures: Departures, statistic: str, axis: str) -> tuple[Floats, Floats]:
    """Edges, and number of beams in each bin."""
    part = departures.place(statistic, axis)
    assert part is not None
    (group,) = [one for one in departures.layout.groups if (one.statistic, one.axis) == (statistic, axis)]
    return bounded(group.edges), departures.weight[:, part].mean(0)


def _in_front(departures: Departures, group: Group, places: Floats, shares: Floats) -> Floats:
    """Share of the places that lie in front of the surfaces of each bin."""
    ends, beams = _beams(departures, "new_share", "range_m")
    surface = 0.5 * (ends[1:] + ends[:-1])
    nearer = np.interp(surface, places, np.concatenate([[0.0], np.cumsum(shares)]))
    found = nearer if group.axis == "range_m" else np.full(group.bins, (beams * nearer).sum() / max(beams.sum(), 1.0))
    positive: Floats = np.maximum(found, 1e-6)
    return positive


def _along(
    group: Group,
    value: Floats,
    kind: str,
    of: str,
    places_m: list[float] | None = None,
    shares: list[float] | None = None,
) -> Empirical | str:
    """The stage of a curve over a group's bins; nodes in the middle of those that are known."""
    known = np.flatnonzero(np.isfinite(value))
    if not len(known):
        return "no bin holds enough to count"
    edges = bounded(group.edges)
    at = [float(one) for one in 0.5 * (edges[known] + edges[known + 1])]
    nodes = [float(one) for one in value[known]]
    first, last = float(edges[known[0]]), float(edges[known[-1] + 1])
    if group.axis == "azimuth_rad" and last - first > 2.0 * math.pi - 1e-3:
        seam = 0.5 * (nodes[0] + nodes[-1])
        at, nodes = [first, *at, last], [seam, *nodes, seam]
    return Empirical(kind, group.axis, at, nodes, first, last, of, places_m or (), shares or ())
