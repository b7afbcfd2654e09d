"""Snow simulated into recorded beams, as two rules of detection report its echoes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from parts.snow_beams import SCANNER, Beams, azimuth_deg, elevation_deg
from torch import Tensor

import torchweather as tw
from torchweather.stages import Chain, LidarState, Stage

DATA_SHEET_RANGE_AT_10_PERCENT_M = 200.0  # Pandar64, from memory (unverified)
PACK = 0.9  # reflectivity of a pack of snow; of a flake by default 0.25
RULES = ("strongest and last", "last and strongest other")


@dataclass(frozen=True)
class Case:
    """A sensor and the reflectivity of flakes to simulate with; ``None`` is that of the library."""

    name: str
    sensor: tw.Lidar
    flake_reflectivity: float | None = None


def cases() -> list[Case]:
    scanner, plain = (tw.Lidar.preset(name, return_mode="dual") for name in (SCANNER, "velodyne-hdl-64e"))
    far = replace(scanner, range_at_10_percent_m=DATA_SHEET_RANGE_AT_10_PERCENT_M)
    fainter = (far.range_at_10_percent_m / scanner.range_at_10_percent_m) ** 2
    name = f"{SCANNER} with {far.range_at_10_percent_m:g} m at 10 %, flakes of {PACK / fainter:.2f}"
    return [Case(SCANNER, scanner), Case("velodyne-hdl-64e", plain), Case(name, far, PACK / fainter)]


class LastAndOther(Stage):
    """Detection as the recording sensor does it: the last echo, and the strongest of the others.

    An echo within ``echo_separation`` of a stronger one is part of that one, as in ``Detection``.
    """

    def __init__(self, sensor: tw.Lidar) -> None:
        super().__init__()
        self.sensor = sensor

    def forward(self, state: LidarState, noise: Mapping[str, Tensor]) -> LidarState:
        range_m, signal = state.returns.range_m, state.returns.signal
        strength = torch.where(signal >= state.receiver.threshold, signal, 0.0)
        near = (state.scene.clear_range_m > 0) & (state.scene.clear_range_m < self.sensor.near_start_m)
        strength[..., 0] = torch.where(
            near, torch.inf, torch.where(state.scene.clear_range_m > 0, strength[..., 0], 0.0)
        )
        kept = strength.clone()
        for k in range(strength.shape[-1]):
            louder = strength > strength[..., k : k + 1]
            close = (range_m - range_m[..., k : k + 1]).abs() < self.sensor.echo_separation
            kept[..., k] = torch.where((louder & close).any(-1), 0.0, strength[..., k])
        last = torch.where(kept > 0, range_m, 0.0).argmax(-1, keepdim=True)
        others = kept.scatter(-1, last, 0.0)
        other = others.argmax(-1, keepdim=True)
        chosen = torch.cat([last, other], -1)
        there = torch.cat([kept.gather(-1, last), others.gather(-1, other)], -1) > 0
        lost = torch.full_like(state.returns.kind[..., :2], int(tw.PointKind.LOST))
        return state.changed(
            range_m=torch.where(there, range_m.gather(-1, chosen), 0.0),
            signal=torch.where(there, signal.gather(-1, chosen), 0.0),
            kind=torch.where(there, state.returns.kind.gather(-1, chosen), lost),
        )


def simulated(cloud: Tensor, along: Tensor, case: Case, rate_mm_per_h: float, seed: int) -> list[Beams]:
    """Snow in a frame, as each of `RULES` reports it: one storm, seen twice."""
    snow = tw.Snow(rate_mm_per_h=rate_mm_per_h, flake_reflectivity=case.flake_reflectivity)
    lidar = tw.LidarSnow(snow, case.sensor)
    noise = lidar.draw(cloud, seed=seed)
    found = []
    for rule in RULES:
        if rule != RULES[0]:
            lidar.chain = Chain({**lidar.chain.stages, "detection": LastAndOther(case.sensor)})
        with torch.no_grad():
            result = lidar.run(cloud, noise, directions=along)
        assert isinstance(result.points, Tensor)
        assert isinstance(result.second, Tensor)
        assert isinstance(result.kind, Tensor)
        assert isinstance(result.second_kind, Tensor)
        both = torch.stack([result.points, result.second], 1)
        kinds = torch.stack([result.kind, result.second_kind], 1)
        there = kinds != tw.PointKind.LOST
        found.append(
            Beams(
                object_m=cloud[:, :3].norm(dim=-1),
                azimuth_deg=azimuth_deg(along),
                elevation_deg=elevation_deg(along),
                range_m=torch.where(there, both[..., :3].norm(dim=-1), 0.0),
                intensity=torch.where(there, both[..., 3], 0.0),
                snow=kinds == tw.PointKind.PARTICLE,
            )
        )
    return found
