"""Radar stages that end a chain: radar_detection and to_radar_points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.random import Variate
from torchweather.pipeline.point_kind import PointKind
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.radar.sensor import Radar
from torchweather.radar.state import RadarState

__all__ = ["POWER", "RadarDetection", "ToRadarPoints"]

POWER = 4  # column of a list
OBJECT, PARTICLE, LOST = (int(kind) for kind in (PointKind.OBJECT, PointKind.PARTICLE, PointKind.LOST))


@register
class RadarDetection(Stage):
    """A target is reported where its power exceeds the noise floor by the radar's detection SNR.

    What the input lists was detected. A point whose power column says otherwise stands above the threshold by a margin
    of exponential law with the mean ``margin_db``, so that no point is lost for its power column alone.

    Args:
        sensor: the radar, or its dictionary.
    """

    default_name: ClassVar[str] = "radar_detection"
    reads: ClassVar[tuple[str, ...]] = (
        "scene.points_in",
        *("returns.clutter", "returns.clutter_valid", "returns.gain_db", "returns.kind"),
        "receiver.detection_snr_db",
        "receiver.noise_floor_db",
        "receiver.noise_shift_db",
        "receiver.threshold_shift_db",
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.kind", "returns.snr_db")
    margin_db: Tensor

    def __init__(self, sensor: Radar | Mapping[str, Any]) -> None:
        check_arguments("RadarDetection(sensor: Radar | Mapping)", sensor)
        super().__init__()
        self.sensor = Radar.of(sensor)
        self.register_buffer("margin_db", torch.tensor(float(self.sensor.margin_db)))

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"sensor": self.sensor.to_dict()}

    def variates(self) -> tuple[Variate, ...]:
        """The margin of each point, as the probability of a smaller one."""
        return (Variate("margin", "uniform", ("N",)),)

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with what is lost marked so."""
        excess = (
            state.scene.points_in[..., POWER]
            - (state.receiver.noise_floor_db + state.receiver.detection_snr_db)[:, None]
        )
        margin = self.margin_db * -(1.0 - noise["margin"].to(excess)).log()
        excess = torch.where(excess < 0, margin.to(excess), excess)
        above = excess + state.returns.gain_db
        snr = above + state.receiver.detection_snr_db
        if state.receiver.noise_shift_db is not None:
            above, snr = above - state.receiver.noise_shift_db[:, None], snr - state.receiver.noise_shift_db[:, None]
        if state.receiver.threshold_shift_db is not None:
            above = above - state.receiver.threshold_shift_db[:, None]
        kind = state.returns.kind.masked_fill(above < 0, LOST)
        snr = torch.where(state.returns.kind == LOST, -math.inf, snr)
        if state.returns.clutter is not None and state.returns.clutter_valid is not None:
            own = torch.where(state.returns.clutter_valid, PARTICLE, LOST).to(torch.int8)
            clutter_snr = state.returns.clutter[..., POWER] - state.floor_db[:, None]
            clutter_snr = torch.where(state.returns.clutter_valid, clutter_snr, -math.inf)
            kind, snr = torch.cat([kind, own], 1), torch.cat([snr, clutter_snr], 1)
        return state.changed(kind=kind, snr_db=snr)


@register
class ToRadarPoints(Stage):
    """The list as the radar gives it: weakened powers, empty rows where nothing is detected, the weather's own rows.

    A lost row has x, y, z of 0; what else it held stays, its power weakened. Where the weather did nothing, the input
    comes out with its own bits.
    """

    default_name: ClassVar[str] = "to_radar_points"
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.points_in", "scene.range_m"),
        *("returns.clutter", "returns.gain_db", "returns.kind"),
    )
    writes: ClassVar[tuple[str, ...]] = ("returns.points",)

    def config(self) -> dict[str, Any]:
        """Constructor arguments: none."""
        return {}

    def forward(self, state: RadarState, noise: Mapping[str, Tensor]) -> RadarState:
        """The state with the list that goes out."""
        points = state.scene.points_in
        power = points[..., POWER]
        weaker = torch.where(state.returns.gain_db == 0, power, power + state.returns.gain_db)
        lost = (state.returns.kind[:, : points.shape[1]] == LOST) & (state.scene.range_m > 0)
        place = points[..., :3].masked_fill(lost[..., None], 0.0)
        points = torch.cat([place, points[..., 3:POWER], weaker[..., None].to(points), points[..., POWER + 1 :]], -1)
        if state.returns.clutter is not None:
            further = points.new_zeros(
                *state.returns.clutter.shape[:2], points.shape[-1] - state.returns.clutter.shape[-1]
            )
            points = torch.cat([points, torch.cat([state.returns.clutter.to(points), further], -1)], 1)
        return state.changed(points=points)
