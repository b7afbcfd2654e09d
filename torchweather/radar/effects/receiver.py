"""Effects of radar that lie in its receiver, its detector and its clock.

Bounds and typical sizes are orders of magnitude where no source is named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.core.random import Variate
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.tiling import is_exporting
from torchweather.radar.clutter import DB, clutter_directions_rad
from torchweather.radar.effects.echoes import Appending, listed
from torchweather.radar.effects.path import LOST, of_state, plus
from torchweather.radar.state import RadarState

__all__ = [
    "RadarCfarShift",
    "RadarDetectionLimit",
    "RadarDopplerSpread",
    "RadarInterference",
    "RadarNoiseFloor",
    "RadarRangeMigration",
]

SPEED = 3  # column of a list
NOISE_ROWS = 256  # that a lower threshold appends
FULL = 0.8  # expected share of them that is filled where noise abounds


class RadarNoiseFloor(Effect):
    """The noise floor is higher or lower: SNRs fall or rise and weak targets go; powers stay.

    Args:
        shift_db: of the floor, -20 to 20 dB.

    Note:
        What the input does not list cannot come back: a lower floor only keeps what the weather would take.
    """

    id: ClassVar[str] = "radar.noise_floor"
    title: ClassVar[str] = "the noise floor is another"
    term: ClassVar[str] = "noise floor (noise figure, thermal noise)"
    # Noise figures of 77 GHz chips lie between 10 and 16 dB and drift by a few dB with temperature.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("shift_db", "dB", -20.0, 20.0, scale=2.0, identity=0.0),)
    percollect: ClassVar[str | None] = "Noise floor"
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = -2
    axes: ClassVar[tuple[str, ...]] = ("noise_floor_db", "snr_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.cfar_shift": "the floor of empty cells; without it the two are one",
        "radar.interference": "floors of single frames: an interferer raises some of them",
        "radar.wet_radome": "powers, which a noise floor leaves alone",
    }
    reads: ClassVar[tuple[str, ...]] = ("receiver.cover_loss_db", "receiver.noise_shift_db", "scene.points_in")
    writes: ClassVar[tuple[str, ...]] = ("receiver.noise_shift_db",)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Rise of the floor."""
        return {"noise_shift_db": plus(state.receiver.noise_shift_db, of_state(self, "shift_db", state))}


class RadarCfarShift(Appending):
    """The detector asks for more SNR, or less: weak targets go, or noise is listed; powers and floor stay.

    The power of an empty cell is exponential about the floor. From the SNR T on, a ratio, it is detected in
    ``cells exp(-T)`` of the cells; a threshold that falls from T0 to T lists ``cells (exp(-T) - exp(-T0))`` more, a
    Poisson number, with powers of the same law between the two, at ranges and speeds anywhere.

    Args:
        shift_db: of the SNR that is detected, -20 to 20 dB.

    Note:
        What the input does not list cannot come back: a lower threshold only keeps what the weather would take, lists
        more clutter where the chain has some, and noise. Cells are those of the range-Doppler map,
        ``Radar.range_doppler_cells``: a radar that averages the powers of its channels lists less noise, one that looks
        for detections in every direction of a cell more. At most 256 rows, of which four fifths are filled where there
        would be more.

    References:
        PHYSICS.md 6.8. Skolnik, Introduction to Radar Systems (false alarms of exponential noise); primary text not
        seen.
    """

    id: ClassVar[str] = "radar.cfar_shift"
    title: ClassVar[str] = "the detection threshold is another"
    term: ClassVar[str] = "detection (CFAR) threshold"
    # A false-alarm rate of 1e-4 instead of 1e-6 costs 1.8 dB: ln(1e6) / ln(1e4) for exponential noise.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("shift_db", "dB", -20.0, 20.0, scale=2.0, identity=0.0),)
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = -1  # behind the floor, which the noise that is listed exceeds
    axes: ClassVar[tuple[str, ...]] = ("margin_db", "clutter_range_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.noise_floor": "the floor of empty cells; without it the two are one",
        "radar.wet_radome": "powers, which a threshold leaves alone",
        "radar.detection_limit": "the number of detections of frames with many targets: a limit is a ceiling",
    }
    needs: ClassVar[tuple[str, ...]] = ("sensor",)
    silent: ClassVar[str] = "with a threshold that is no lower"
    reads: ClassVar[tuple[str, ...]] = (
        "scene.points_in",
        *("receiver.cover_loss_db", "receiver.sensor", "receiver.threshold_shift_db"),
    )
    writes: ClassVar[tuple[str, ...]] = ("receiver.threshold_shift_db",)
    shift_db: Tensor

    def lists(self) -> bool:
        """True where the threshold is lower: a higher one lists no noise."""
        return bool((self.shift_db < 0).any())

    def own_variates(self) -> tuple[Variate, ...]:
        """Variates of each row: presence and place."""
        names = ("arrival", "power", "range", "azimuth", "elevation", "speed")
        return tuple(Variate(name, "uniform", (NOISE_ROWS,)) for name in names)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Rise of the threshold."""
        return {"threshold_shift_db": plus(state.receiver.threshold_shift_db, of_state(self, "shift_db", state))}

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state after the effect; one that requires a gradient needs no noise while it lists none."""
        if not noise and (is_exporting() or not self.lists()):
            return self.without_rows(state, noise)
        changed: RadarState = super().forward(state, noise)
        return changed

    def without_rows(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with a threshold that is no lower."""
        changed: RadarState = Effect.forward(self, state, noise)
        return changed

    def appended(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with what is detected of noise."""
        sensor = state.receiver.sensor
        assert sensor is not None
        drawn = {name: values.to(state.returns.gain_db) for name, values in noise.items()}
        now_db = (state.detected_from_db - state.floor_db)[:, None]
        now, before = (DB * now_db).exp(), (DB * (now_db - of_state(self, "shift_db", state)[:, None])).exp()
        between = 1.0 - (-(before - now).clamp_min(0.0)).exp()  # of what exceeds the lower threshold
        expected = (sensor.range_doppler_cells * (-now).exp() * between).clamp_max(FULL * NOISE_ROWS)
        there = -(1.0 - drawn["arrival"]).log().cumsum(1) < expected
        snr = now - (1.0 - drawn["power"] * between).log()
        power_db = state.floor_db[:, None] + snr.log() / DB
        range_m = sensor.max_range_m * (1.0 - drawn["range"])  # never 0, which is no detection
        azimuth, elevation = clutter_directions_rad(sensor, drawn["azimuth"], drawn["elevation"])
        flat = elevation.cos()
        along = torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()], -1)
        speed = sensor.max_speed_m_per_s * (2.0 * drawn["speed"] - 1.0)
        off_db = 2.0 * (sensor.gain_dbi(azimuth, elevation) - sensor.antenna_gain_dbi)
        rcs_dbsm = power_db - sensor.constant_db - off_db + 4.0 * range_m.log() / DB
        rows = torch.cat([along * range_m[..., None], torch.stack([speed, power_db, rcs_dbsm], -1)], -1)
        return listed(state, torch.where(there[..., None], rows, 0.0), there)


class RadarInterference(Effect):
    """Another radar interferes: some frames' noise floor is raised, all others' is not.

    Args:
        probability: that a frame is hit, 0 to 1.
        level_db: by which its floor rises, 0 to 40 dB.

    References:
        Texas Instruments SWRA662A, table 2-1: 4 to 34 dB at 77 GHz for radars that face each other at 1 to 10 m, with 1
        to 10 % of the samples hit.
    """

    id: ClassVar[str] = "radar.interference"
    title: ClassVar[str] = "another radar raises the floor of some frames"
    term: ClassVar[str] = "mutual interference"
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("probability", "1", 0.0, 1.0, scale=0.2, identity=0.0),
        Parameter("level_db", "dB", 0.0, 40.0, scale=10.0, default=10.0),
    )
    percollect: ClassVar[str | None] = "Radar crosstalk"
    after: ClassVar[str] = "path_attenuation"
    rank: ClassVar[int] = -2
    axes: ClassVar[tuple[str, ...]] = ("noise_floor_db", "frame")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.noise_floor": "floors of single frames: a receiver raises all of them",
        "radar.fluctuation": "powers, which an interferer leaves alone, and targets that are lost together",
    }
    reads: ClassVar[tuple[str, ...]] = ("receiver.cover_loss_db", "receiver.noise_shift_db", "scene.points_in")
    writes: ClassVar[tuple[str, ...]] = ("receiver.noise_shift_db",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a frame."""
        return (Variate("hit", "uniform", (1,)),)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Rise of the floor."""
        tossed = noise["hit"][:, 0].to(state.receiver.cover_loss_db)
        level = torch.where(tossed < of_state(self, "probability", state), of_state(self, "level_db", state), 0.0)
        return {"noise_shift_db": plus(state.receiver.noise_shift_db, level)}


class RadarDopplerSpread(Effect):
    """Measured speeds scatter more: each gets a normal error more, of targets and of clutter.

    Args:
        std_m_per_s: 0 to 10 m/s.

    Note:
        A ghost shares the error of its target. Speeds of targets are not folded into the radar's interval.
    """

    id: ClassVar[str] = "radar.doppler_spread"
    title: ClassVar[str] = "speeds scatter more"
    term: ClassVar[str] = "Doppler spread"
    # A Doppler bin is 0.1 m/s wide in the presets; swaying leaves and walking people spread by 0.1 to 1 m/s.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("std_m_per_s", "m/s", 0.0, 10.0, scale=0.1, identity=0.0),)
    percollect: ClassVar[str | None] = "Detection velocity error"
    after: ClassVar[str] = "path_attenuation"
    axes: ClassVar[tuple[str, ...]] = ("speed_residual_spread",)
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.volume_clutter": "speeds of targets, which clutter leaves alone",
    }
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.points_in", "scene.range_m"),
        *("receiver.cover_loss_db", "receiver.speed_std_m_per_s"),
    )
    writes: ClassVar[tuple[str, ...]] = ("receiver.speed_std_m_per_s", "scene.points_in")

    def variates(self) -> tuple[Variate, ...]:
        """A number a target; clutter has its own."""
        return (Variate("error", "normal", ("N",)),)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Speeds of the targets, and what clutter's scatter by."""
        own = of_state(self, "std_m_per_s", state)
        error = own[:, None] * noise["error"].to(own)
        column = torch.arange(state.scene.points_in.shape[-1], device=own.device) == SPEED
        moved = (state.scene.range_m > 0)[..., None] & column
        points = torch.where(
            moved, state.scene.points_in + error[..., None].to(state.scene.points_in), state.scene.points_in
        )
        before = state.receiver.speed_std_m_per_s
        return {
            "points_in": points,
            "speed_std_m_per_s": own if before is None else (own.square() + before.square()).sqrt(),
        }


class RadarRangeMigration(Effect):
    """Measured ranges drift from frame to frame: ``R + m n`` in frame n, of targets, ghosts and clutter.

    Args:
        m_per_frame: m, -1 to 1.

    Note:
        The caller says which frame it is, from 0 (``frame_number``). Ranges do not fall below 0.
    """

    id: ClassVar[str] = "radar.range_migration"
    title: ClassVar[str] = "ranges drift from frame to frame"
    term: ClassVar[str] = "range migration (range walk)"
    # A speed of 1 m/s that the model does not have, at 10 to 20 frames a second.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("m_per_frame", "m", -1.0, 1.0, scale=0.05, identity=0.0),)
    percollect: ClassVar[str | None] = "Detection position error"
    after: ClassVar[str] = "to_radar_points"
    axes: ClassVar[tuple[str, ...]] = ("range_residual_mean", "frame")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.doppler_spread": "ranges, and whether the residual of the speed has a mean"
    }
    needs: ClassVar[tuple[str, ...]] = ("frame_number", "points")
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.frame_number", "scene.points_in"),
        *("returns.kind", "returns.points"),
        "receiver.cover_loss_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.points",)

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The list that goes out, its places moved along their directions."""
        assert state.returns.points is not None
        assert state.scene.frame_number is not None
        place = state.returns.points[..., :3]
        range_m = place.square().sum(-1).sqrt()
        there = (state.returns.kind != LOST) & (range_m > 0)
        drift = of_state(self, "m_per_frame", state) * state.scene.frame_number.to(range_m)
        longer = (1.0 + drift[:, None] / torch.where(there, range_m, 1.0)).clamp_min(0.0)
        moved = torch.where(there[..., None], place * longer[..., None], place)
        return {"points": torch.cat([moved, state.returns.points[..., 3:]], -1)}


class RadarDetectionLimit(Effect):
    """The list is full: only the strongest detections of a frame are reported, targets, ghosts and clutter together.

    Args:
        max_count: how many, 1 to infinity.

    Note:
        What a limit drops is LOST.
    """

    id: ClassVar[str] = "radar.detection_limit"
    title: ClassVar[str] = "only the strongest detections are listed"
    term: ClassVar[str] = "limit of the detection list"
    # Lists of series radars end at 64 to 256 entries.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("max_count", "1", 1.0, math.inf, scale=64.0, identity=math.inf),
    )
    after: ClassVar[str] = "radar_detection"
    axes: ClassVar[tuple[str, ...]] = ("detections", "snr_db")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "radar.cfar_shift": "the number of detections of frames with few targets, which a limit leaves alone"
    }
    needs: ClassVar[tuple[str, ...]] = ("snr_db",)
    cuts: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = (
        "scene.points_in",
        *("returns.clutter", "returns.clutter_valid", "returns.kind", "returns.snr_db"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.clutter", "returns.clutter_valid", "returns.kind")

    def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Kinds, and the clutter that is left."""
        assert state.returns.snr_db is not None
        strength = torch.where(state.returns.kind == LOST, -torch.inf, state.returns.snr_db.detach())
        # The rank of each is the place at which a second sort finds it.
        order = torch.sort(strength, dim=-1, descending=True).indices
        rank = torch.sort(order, dim=-1).indices
        dropped = rank >= self.value("max_count", strength)
        found = {"kind": state.returns.kind.masked_fill(dropped, LOST)}
        if state.returns.clutter is not None and state.returns.clutter_valid is not None:
            kept = ~dropped[:, state.scene.points_in.shape[1] :]
            found["clutter"] = torch.where(kept[..., None], state.returns.clutter, 0.0)
            found["clutter_valid"] = state.returns.clutter_valid & kept
        return found
