"""Radar frames to sums over bins: what became of each target, of the empty cells, and what was detected besides.

A target is *lost*, or detected with another power, speed and range than in the mean of the clear frames. Powers are
compared after the loss on the path that the recorded weather says, so that what is left is even over the range where
nothing is missing; spreads are about the frame's own mean and in units of the target's own in clear air. All further
detections (``clutter``) are counted by range, and those that follow a target in its direction at its speed by how far
behind it they lie. How the list was read out is told by values that come again and by speeds far off
(``radar_readout.py``).

References:
    GAP.md 3 (1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from torchweather.gap.sensors.radar.readout import FAR_OFF_SD, far_off, repeated
from torchweather.gap.sensors.radar.scene import MEASURED, Detections, RadarScene
from torchweather.gap.statistics.frame_statistics import PARTICLE_AXIS, Group, Layout, Reduced

__all__ = ["FLOOR_STEPS_DB", "GHOST_DELAY_M", "RadarSums", "floor_ramps", "radar_layout"]

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]

CLUTTER_RANGE_M = (0.0, 2.0, 4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 1e4)
# A delay counts in all bins by how near it is to their middles (on a logarithmic axis, by a bell of so many bins): so
# that a simulation at another delay tells which way to go.
GHOST_BELL = 0.8
GHOST_DELAY_M = tuple(0.2 * 2.0**step for step in range(11))
# A floor is looked at in steps that it fills one after the other, each together with its neighbours, so that a
# simulation at another level tells which way to go: those near 0 tell 0.01 dB, the last ones interference.
FLOOR_STEPS_DB = (
    -20.0,
    -10.0,
    -5.0,
    -2.0,
    -0.8,
    -0.3,
    -0.1,
    0.1,
    0.3,
    0.8,
    2.0,
    3.5,
    5.0,
    7.0,
    10.0,
    14.0,
    20.0,
    28.0,
    40.0,
)
FLOOR_WEIGHT = 20.0  # of a frame's floor, which is the mean of very many cells
# Within which a detection follows a target: a degree or two of direction, a few bins of speed (orders of magnitude).
SAME_DIRECTION_RAD, SAME_SPEED_M_PER_S = 0.02, 0.4
ONE_DELAY = 1.5  # factor within which delays are those of one second path, order of magnitude
# By which the logarithm of a delay, and the power of a further detection in dB, scatter at least from one path to the
# next: no two are known better. A path is the same one in all frames.
READ_TO = {"log_ghost_delay": 0.1, "ghost_power_db": 1.0, "clutter_snr_db": 1.0}
EVERYWHERE = ("range_m", "margin_db", "azimuth_rad", "elevation_rad", "target_class")
# Weight, value and square of each statistic.
SUMS = {
    "lost_target_share": ("target", "lost", "lost"),
    "lost_flickering_share": ("flickers", "gone", "gone"),
    "power_residual_db": ("steady", "power", "power2"),
    "power_spread": ("free", "fluctuation", "fluctuation2"),
    "speed_residual_m_per_s": ("there", "speed", "speed2"),
    "speed_spread": ("free", "speed_wide", "speed_wide2"),
    "range_error_m": ("there", "apart", "apart2"),
    "range_spread": ("free", "wide", "wide2"),
    "range_drift_m": ("lever", "drift", "apart2"),
}
REPEATED = {f"repeated_{name.split('_')[0]}_share": name for name in MEASURED}
FEWEST_CLEAR = 3  # frames, for the spread of a target: all but one, and one more than a mean takes
VALUES = tuple(dict.fromkeys(name for names in SUMS.values() for name in names))
FROM_CLEAR = ("lost_target_share", "lost_flickering_share", "speed_far_off_share", "clutter_count", "ghost_count")
# Which targets flicker, and which read far off, the clear frames' own noise has chosen: 40 null studies scatter by so
# much more, in the square, than simulated frames that start from those.
CHOSEN_BY_NOISE = {"lost_flickering_share": 1.5, "speed_far_off_share": 1.6}
ABOUT_OWN_MEAN = ("power_spread", "speed_spread", "range_spread")
SCALARS = ("detections_root", "power_residual_db", "clutter_root")
# Scatter from frame to frame below which frames are called alike: of 0.5 of a stabilised count, and in dB.
STEADY = (0.1, 0.02, 0.35)
ANSCOMBE = 3.0 / 8.0


def radar_layout(edges: Mapping[str, tuple[float, ...]]) -> Layout:
    """Statistics along each of the axes that the scenes have.

    Args:
        edges: of the bins of each axis (``radar_edges``).
    """
    groups: list[Group] = []

    def add(statistic: str, kind: str, *axes: str) -> None:
        groups.extend(Group(statistic, axis, kind, edges[axis]) for axis in axes if axis in edges)

    add("lost_target_share", "share", *EVERYWHERE)
    add("lost_flickering_share", "share", "range_m", "margin_db")
    add("power_residual_db", "mean", *EVERYWHERE)
    add("power_spread", "mean", "range_m", "margin_db", "target_class")
    add("speed_residual_m_per_s", "mean", "range_m")
    add("speed_spread", "mean", "range_m", "margin_db", "target_class")
    add("range_error_m", "mean", "range_m")
    add("range_spread", "mean", "range_m", "margin_db")
    groups.append(Group("range_drift_m", "frame", "mean", (0.0, 1.0)))
    groups.append(Group("speed_far_off_share", "departure_sd", "share", FAR_OFF_SD))
    groups += [Group(statistic, "all_targets", "share", (0.0, 1.0)) for statistic in REPEATED]
    groups.append(Group("noise_floor_share", "noise_floor_db", "share", FLOOR_STEPS_DB))
    groups.append(Group("clutter_count", PARTICLE_AXIS, "count", CLUTTER_RANGE_M))
    groups += [
        Group(statistic, PARTICLE_AXIS, kind, CLUTTER_RANGE_M, READ_TO.get(statistic, 0.0))
        for statistic, kind in (
            ("clutter_snr_db", "mean"),
            ("clutter_speed_m_per_s", "mean"),
            ("clutter_speed_spread", "spread"),
        )
    ]
    groups.append(Group("ghost_count", "ghost_delay_m", "count", GHOST_DELAY_M))
    whole = (CLUTTER_RANGE_M[0], CLUTTER_RANGE_M[-1])
    groups.append(Group("log_ghost_delay", PARTICLE_AXIS, "mean", whole, READ_TO["log_ghost_delay"]))
    groups.append(Group("log_ghost_delay", PARTICLE_AXIS, "spread", whole))
    groups.append(Group("ghost_power_db", PARTICLE_AXIS, "mean", whole, READ_TO["ghost_power_db"]))
    return Layout(tuple(groups), SCALARS, STEADY, (), FROM_CLEAR, ABOUT_OWN_MEAN, scatter_share=CHOSEN_BY_NOISE)


class RadarSums:
    """Reduces frames of one scene.

    Args:
        scene: with its clear frames.
        layout: of the statistics.
    """

    def __init__(self, scene: RadarScene, layout: Layout) -> None:
        self.scene, self.layout = scene, layout
        axes = scene.axes
        self._hot: dict[str, Floats] = {}  # (K, N, bins): 1 in the bin of each target
        for group in layout.binned:
            if group.axis in axes and group.axis not in self._hot:
                place = np.searchsorted(np.asarray(group.edges), axes[group.axis], side="right") - 1
                place = np.where(scene.counted, np.minimum(place, group.bins - 1), -1)
                self._hot[group.axis] = (place[..., None] == np.arange(group.bins)).astype(np.float64)
        self._hot["frame"] = scene.counted[..., None].astype(np.float64)
        self._evenly = {axis: _as_many(scene.level_weight["power_db"], hot) for axis, hot in self._hot.items()}
        self._portion: dict[int, Whole] = {}
        # Where clear frames are written in steps already those say nothing: a simulated frame is off them.
        self._in_steps = {name: bool(repeated(getattr(scene.clear, name)).any()) for name in MEASURED}

    def __call__(
        self, frames: Detections, row: Whole, loss_db: Floats, lever: Floats, portions: int = 1, together: int = 0
    ) -> Reduced:
        """Sums of frames.

        Args:
            frames: of the scene.
            row: ``(F,)`` clear frame that each is not compared with.
            loss_db: ``(N,)`` of the path in the recorded weather, both ways together.
            lever: ``(F,)`` place of each in its recording, of mean 0 and mean square 1 over its frames.
            portions: into which the targets are divided at random, the same ones in each frame; the result then has
                ``F * portions`` rows, one for each frame and portion, frame by frame.
            together: successive frames over which a target's own mean is taken, of different clear frames; 0: all.
        """
        values = self._of_targets(frames, row, loss_db, lever, together or len(frames))
        stacked = np.stack([values[name] for name in VALUES], 1)  # (F, V, N)
        sums: dict[tuple[str, str], Floats] = {}
        for axis, hot in self._hot.items():
            summed = self._summed(stacked, hot[row], portions)  # (F portions, V, bins)
            sums |= {(name, axis): summed[:, place] for place, name in enumerate(VALUES)}
        rows = len(frames) * portions
        parts: list[tuple[Floats, Floats, Floats]] = []
        further = self._further(frames, portions)
        for group in self.layout.binned:
            if group.statistic in SUMS:
                weight, value, square = (sums[name, group.axis] for name in SUMS[group.statistic])
                if group.statistic == "power_residual_db":
                    evenly = self._evenly[group.axis][row].repeat(portions, 0)
                    weight, value, square = (one * evenly for one in (weight, value, square))
            elif group.statistic == "speed_far_off_share":
                weight, value, square = self._far_off(frames, row, portions)
            elif group.statistic in REPEATED:
                weight, value, square = self._repeated(frames, REPEATED[group.statistic], row, portions)
            elif group.statistic == "noise_floor_share":
                weight, value, square = self._floor(frames, row, portions)
            elif group.statistic == "ghost_count":
                weight, value, square = _shared_out(further["ghost_count"][0], further["row"][1].astype(np.int64), rows)
            else:
                place, own = further[group.statistic]
                weight, value, square = _binned(group, place, own, further["row"][1].astype(np.int64), rows)
            parts.append((weight, value, square))
        weight, value, square = (np.concatenate(each, 1) for each in zip(*parts, strict=True))
        return Reduced(weight, value, square, self._scalars(frames, values, portions), np.zeros((rows, 0, 0)))

    def _of_targets(
        self, frames: Detections, row: Whole, loss_db: Floats, lever: Floats, together: int
    ) -> dict[str, Floats]:
        """Summand of each target, ``(F, N)``; 0 where it does not count."""
        scene = self.scene
        reference = {name: values[row] for name, values in scene.reference.items()}
        counted = scene.counted[row]
        there = ~np.isnan(frames.power_db) & counted
        valued = there & scene.known
        weight = valued.astype(np.float64)

        def residual(name: str) -> Floats:
            return np.where(valued, getattr(frames, name) - reference[name], 0.0)

        power = np.where(valued, residual("power_db") + loss_db, 0.0)
        speed, apart = residual("speed_m_per_s"), residual("range_m")
        steady = weight * scene.level_weight["power_db"][row]
        is_steady = scene.steady[row]
        found = {
            "target": is_steady.astype(np.float64),
            "lost": (is_steady & ~there).astype(np.float64),
            "flickers": (counted & ~is_steady).astype(np.float64),
            "gone": (counted & ~is_steady & ~there).astype(np.float64),
            "steady": steady,
            "power": steady * power,
            "power2": steady * power**2,
            "there": weight,
            "speed": speed,
            "speed2": speed**2,
            "apart": apart,
            "apart2": apart**2,
            "lever": weight * lever[:, None] ** 2,
            "drift": apart * lever[:, None],
        }
        number = over_frames(weight, together)
        # Degrees of freedom that each frame brings; of two clear frames the one that is left tells no spread.
        known = len(scene.clear) >= FEWEST_CLEAR
        found["free"] = known * weight * (1.0 - 1.0 / np.maximum(number, 1.0))
        for name, least in (("fluctuation", "power_db"), ("speed_wide", "speed_m_per_s"), ("wide", "range_m")):
            of = np.where(valued, getattr(frames, least), 0.0)
            of = of - over_frames(of, together) / np.maximum(number, 1.0)
            kept = weight * scene.level_weight[least][row]
            common = (kept * of).sum(1, keepdims=True) / np.maximum(kept.sum(1, keepdims=True), 1e-9)
            scatter = weight * (of - common) ** 2 * number / np.maximum(number - 1.0, 1.0)
            # Grows with the spread, and hardly with what lies far out.
            grown = np.log1p(scatter / scene.spread[least][row] ** 2)
            found[name], found[f"{name}2"] = found["free"] * grown, found["free"] * grown**2
        return found

    def _summed(self, values: Floats, hot: Floats, portions: int) -> Floats:
        """Sums ``(F * portions, V, bins)`` of values ``(F, V, N)`` over bins ``(F, N, bins)``."""
        if portions == 1:
            found: Floats = values @ hot
            return found
        own = (self._portions(portions)[:, None] == np.arange(portions)).astype(np.float64)
        apart = (values[..., None] * hot[:, None]).swapaxes(-1, -2) @ own  # (F, V, bins, portions)
        count = len(values) * portions
        return np.asarray(np.moveaxis(apart, -1, 1).reshape(count, values.shape[1], hot.shape[-1]), dtype=np.float64)

    def _far_off(self, frames: Detections, row: Whole, portions: int) -> tuple[Floats, Floats, Floats]:
        """Number of targets with speeds so far from their mean in clear air, of all; none where that has no spread."""
        scene = self.scene
        known = scene.counted[row] & scene.known & (len(scene.clear) >= FEWEST_CLEAR)
        there = (~np.isnan(frames.speed_m_per_s) & known).astype(np.float64)
        apart = np.where(there > 0, frames.speed_m_per_s - scene.reference["speed_m_per_s"][row], np.nan)
        spread = np.where(there > 0, scene.spread["speed_m_per_s"][row], 1.0)
        far = self._summed(there[:, None], far_off(apart, spread), portions)[:, 0]
        number = self._summed(there[:, None], there[..., None], portions)[:, 0]
        return np.repeat(number, far.shape[1], 1), far, far

    def _repeated(self, frames: Detections, name: str, row: Whole, portions: int) -> tuple[Floats, Floats, Floats]:
        """Number of targets with a value that another one has, of all; none where clear frames have such."""
        values = np.where(self.scene.counted[row], getattr(frames, name), np.nan)
        there = (~np.isnan(values)).astype(np.float64)[:, None] * (not self._in_steps[name])
        again = self._summed(there, repeated(values)[..., None].astype(np.float64), portions)[:, 0]
        return self._summed(there, np.ones((*values.shape, 1)), portions)[:, 0], again, again

    def _floor(self, frames: Detections, row: Whole, portions: int) -> tuple[Floats, Floats, Floats]:
        """Share of the steps that each frame's floor fills above that of clear air; all of it in the first portion."""
        above = frames.floor_db - self.scene.reference_floor_db[row]
        low, high = floor_ramps()
        filled = np.clip((above[:, None] - low) / (high - low), 0.0, 1.0)
        weight = np.zeros((len(frames) * portions, len(low)))
        value = np.zeros_like(weight)
        weight[::portions], value[::portions] = FLOOR_WEIGHT, FLOOR_WEIGHT * filled
        return weight, value, value

    def _further(self, frames: Detections, portions: int) -> dict[str, tuple[Floats, Floats]]:
        """Where each further detection lies along the axis of each statistic, and its value; NaN where it has none."""
        range_m, _, _, speed, power_db = frames.clutter.T
        frame = frames.clutter_frame
        slot = frame * portions + np.arange(len(frame)) % portions
        delay_m, fainter_db = self._behind(frames)
        one = np.ones(len(frame))
        log_delay = np.log(np.where(delay_m > 0, delay_m, 1.0))
        behind = np.where(_at_one_delay(delay_m), range_m, np.nan)
        return {
            "row": (one, slot.astype(np.float64)),
            "clutter_count": (range_m, one),
            "clutter_snr_db": (range_m, power_db - frames.floor_db[frame]),
            "clutter_speed_m_per_s": (range_m, speed),
            "clutter_speed_spread": (range_m, speed),
            "ghost_count": (delay_m, one),
            "log_ghost_delay": (behind, log_delay),
            "ghost_power_db": (behind, fainter_db),
        }

    def _behind(self, frames: Detections) -> tuple[Floats, Floats]:
        """Distance, m, of each further detection behind the target that it follows best, and its loss, dB; else NaN."""
        scene, frame = self.scene, frames.clutter_frame
        if not len(frame):
            return np.zeros(0), np.zeros(0)
        range_m, azimuth, elevation, speed, power_db = frames.clutter.T
        known = scene.geometry
        # The rest is compared of the few pairs at one speed, and a little more; NaN compares as false.
        apart = np.abs(speed[:, None] - frames.speed_m_per_s[frame])
        further, target = np.nonzero(apart < 1.001 * SAME_SPEED_M_PER_S)
        delay = range_m[further] - frames.range_m[frame[further], target]
        across = np.remainder(azimuth[further] - known["azimuth_rad"][target] + math.pi, 2.0 * math.pi) - math.pi
        up = elevation[further] - known["elevation_rad"][target]
        off = (across / SAME_DIRECTION_RAD) ** 2 + (up / SAME_DIRECTION_RAD) ** 2
        off = off + (apart[further, target] / SAME_SPEED_M_PER_S) ** 2
        near = np.flatnonzero((delay >= GHOST_DELAY_M[0]) & (off < 1.0))
        near = near[np.lexsort((target[near], off[near], further[near]))]
        follows, first = np.unique(further[near], return_index=True)  # the nearest of each
        best = near[first]
        behind, fainter = np.full(len(frame), np.nan), np.full(len(frame), np.nan)
        behind[follows] = delay[best]
        fainter[follows] = power_db[follows] - frames.power_db[frame[follows], target[best]]
        return behind, fainter

    def _scalars(self, frames: Detections, values: Mapping[str, Floats], portions: int) -> Floats:
        further = np.bincount(frames.clutter_frame, minlength=len(frames))
        detected = (~np.isnan(frames.power_db)).sum(1) + further
        power = values["power"].sum(1) / np.maximum(values["steady"].sum(1), 1e-9)
        found = np.stack(
            [
                np.sqrt(detected + ANSCOMBE),
                power,
                np.sqrt(further + ANSCOMBE),
            ],
            1,
        )
        return np.repeat(found, portions, 0)

    def _portions(self, portions: int) -> Whole:
        """Portion of each target ``(N,)``."""
        if portions not in self._portion:
            number = self.scene.counted.shape[1]
            self._portion[portions] = np.random.default_rng(0).permutation(number) * portions // number
        return self._portion[portions]


def _as_many(weight: Floats, hot: Floats) -> Floats:
    """Factor ``(K, bins)`` by which weights ``(K, N)`` in each bin ``(K, N, bins)`` sum up to the number of targets
    that would tell its mean as well if all weighed the same: where all weigh little it is known badly, but counts."""
    own = weight[..., None] * hot
    found: Floats = own.sum(1) / np.maximum((own**2).sum(1), 1e-300)
    return found


def _at_one_delay(delay_m: Floats) -> Flags:
    """Mask of the delays near their median. Noise that is detected behind a target by chance follows it anyhow, and one
    such detection at 100 m would move the mean logarithm of fifteen delays of 2.5 m by a quarter."""
    follows: Flags = ~np.isnan(delay_m)
    if not follows.any():
        return follows
    ratio = np.where(follows, delay_m, 1.0) / np.median(delay_m[follows])
    found: Flags = follows & (ratio < ONE_DELAY) & (ratio > 1.0 / ONE_DELAY)
    return found


def over_frames(values: Floats, together: int) -> Floats:
    """Sums ``(F, N)`` over so many successive frames, for each of them; the last ones may be fewer."""
    block = np.arange(len(values)) // together
    found: Floats = np.add.reduceat(values, np.flatnonzero(np.diff(block, prepend=-1)), 0)[block]
    return found


def floor_ramps() -> tuple[Floats, Floats]:
    """Levels ``(steps,)`` over those of clear air, dB, at which each step begins to fill and is full."""
    steps = np.asarray(FLOOR_STEPS_DB)
    padded = np.concatenate([steps[:1], steps, steps[-1:]])
    return padded[:-3], padded[3:]


def _shared_out(delay_m: Floats, row: Whole, rows: int) -> tuple[Floats, Floats, Floats]:
    """Counts ``(rows, bins)`` of delays, each shared out to bins; NaN to none."""
    edges = np.log(np.asarray(GHOST_DELAY_M))
    bins = len(edges) - 1
    there = ~np.isnan(delay_m)
    step = edges[1] - edges[0]
    place = np.clip((np.log(delay_m[there]) - edges[0]) / step - 0.5, 0.0, bins - 1.0)
    near = np.exp(-0.5 * ((place[:, None] - np.arange(bins)) / GHOST_BELL) ** 2)
    found = np.zeros((rows, bins))
    np.add.at(found, row[there], near / near.sum(1, keepdims=True))
    return np.ones((rows, bins)), found, found


def _binned(group: Group, place: Floats, values: Floats, row: Whole, rows: int) -> tuple[Floats, Floats, Floats]:
    """Number, sum and sum of squares ``(rows, bins)`` of values in the bins of a group; of counts the number of frames
    is the weight."""
    bins = np.searchsorted(np.asarray(group.edges), place, side="right") - 1
    inside = (bins >= 0) & (bins < group.bins) & ~np.isnan(place)
    cell = (row * group.bins + bins)[inside]
    least = READ_TO.get(group.statistic, 0.0) ** 2
    sums: list[Floats] = [
        np.bincount(cell, each, rows * group.bins).reshape(rows, group.bins).astype(np.float64)
        for each in (np.ones(len(cell)), values[inside], values[inside] ** 2 + least)
    ]
    if group.kind == "count":
        return np.ones((rows, group.bins)), sums[1], sums[2]
    return sums[0], sums[1], sums[2]
