"""The state of a radar's detections on their way through a chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.density_field import PatchField
from torchweather.atmosphere.weather import Weather
from torchweather.pipeline.state import PartedState
from torchweather.radar.sensor import Radar

__all__ = ["RadarAir", "RadarReceiver", "RadarReturns", "RadarScene", "RadarState"]


@dataclass(frozen=True)
class RadarScene:
    """Targets of the list that came in.

    Args:
        points_in: ``(B, N, C)`` the list as it came, floating point: x, y, z in metres, radial speed in m/s, power in
            dB, radar cross section in dBsm, further columns.
        range_m: ``(B, N)`` of each; 0 is no detection.
        target_class: ``(1 or B, N)`` whole numbers, below 0 where not known; ``None`` where none is.
        frame_number: ``(B,)`` of the frame in its recording, from 0; ``None`` where not known.
    """

    points_in: Tensor
    range_m: Tensor
    target_class: Tensor | None = None
    frame_number: Tensor | None = None


@dataclass(frozen=True)
class RadarAir:
    """Weather on the way, and earlier rain.

    Args:
        attenuation_db_per_km: ``(B,)`` of the air, one way.
        weathers: the weather with its rates at 0.
        rates_mm_per_h: kind of precipitation to its rates, ``(B,)``.
        patches, extra_m: where about the vehicle the air is dense, as of a LiDAR; ``None`` is everywhere alike.
        past_rain_mm_per_h, past_rain_min: ``(B, T)`` rates of earlier rain, and how many minutes ago; ``None`` where no
            such rain is known of.
    """

    attenuation_db_per_km: Tensor
    weathers: tuple[Weather, ...] | None = None
    rates_mm_per_h: Mapping[str, Tensor] | None = None
    patches: PatchField | None = None
    extra_m: Tensor | None = None
    past_rain_mm_per_h: Tensor | None = None
    past_rain_min: Tensor | None = None


@dataclass(frozen=True)
class RadarReturns:
    """Power and kind of the detections, clutter, and the list that goes out.

    Args:
        gain_db: ``(B, N)`` what the weather does to the power of each; 0 or less but for effects.
        kind: ``(B, N)`` int8, ``PointKind`` of each.
        snr_db: ``(B, N + K)`` signal over the noise floor; ``None`` until the detection.
        clutter: ``(B, K, 6)`` detections of the weather itself, columns as the first six of ``points_in``; ``None``
            without.
        clutter_valid: ``(B, K)`` bool, which of them are there.
        points: ``(B, N + K, C)`` the list that goes out; ``None`` until ``to_radar_points``.
    """

    gain_db: Tensor
    kind: Tensor
    snr_db: Tensor | None = None
    clutter: Tensor | None = None
    clutter_valid: Tensor | None = None
    points: Tensor | None = None


@dataclass(frozen=True)
class RadarReceiver:
    """Radar, cover, noise floor and threshold.

    Args:
        noise_floor_db: ``(B,)`` in the unit of the power column.
        detection_snr_db: ``()`` from which a target is detected.
        cover_loss_db: ``(B,)`` of the radar's cover, both ways together.
        sensor: the radar; ``None`` until ``path_attenuation``, and so the next two.
        ego_speed_m_per_s: of the vehicle, forward.
        noise_shift_db: ``(B,)`` by which the noise floor lies above ``noise_floor_db``; ``None`` is 0.
        threshold_shift_db: ``(B,)`` by which the SNR that is detected lies above ``detection_snr_db``; ``None`` is 0.
        pattern_tilt_rad: ``(B,)`` by which the antenna's pattern is turned, from x to y; ``None`` is 0.
        speed_std_m_per_s: ``(B,)`` by which measured speeds scatter more; ``None`` is 0.
    """

    noise_floor_db: Tensor
    detection_snr_db: Tensor
    cover_loss_db: Tensor
    sensor: Radar | None = None
    ego_speed_m_per_s: float = 0.0
    noise_shift_db: Tensor | None = None
    threshold_shift_db: Tensor | None = None
    pattern_tilt_rad: Tensor | None = None
    speed_std_m_per_s: Tensor | None = None


@dataclass(frozen=True)
class RadarState(PartedState):
    """Detections of a radar on their way through the chain; B is the flattened batch.

    A stage changes ``gain_db``, which is 0 in clear air; where it still is, the input comes out with its own bits.
    """

    parts: ClassVar[dict[str, type[Any]]] = {
        "scene": RadarScene,
        "air": RadarAir,
        "returns": RadarReturns,
        "receiver": RadarReceiver,
    }

    scene: RadarScene
    air: RadarAir
    returns: RadarReturns
    receiver: RadarReceiver

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"N": self.scene.points_in.shape[-2]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.scene.points_in.shape[0]

    @property
    def floor_db(self) -> Tensor:
        """``(B,)`` noise floor of the frame, effects and all."""
        return (
            self.receiver.noise_floor_db
            if self.receiver.noise_shift_db is None
            else self.receiver.noise_floor_db + self.receiver.noise_shift_db
        )

    @property
    def detected_from_db(self) -> Tensor:
        """``(B,)`` power from which a target is detected."""
        level = self.floor_db + self.receiver.detection_snr_db
        return level if self.receiver.threshold_shift_db is None else level + self.receiver.threshold_shift_db


for _part in (RadarScene, RadarAir, RadarReturns, RadarReceiver, RadarState):
    torch.export.register_dataclass(_part, serialized_type_name=f"torchweather.{_part.__name__}")
