"""The state of a LiDAR's cloud on its way through a chain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.atmosphere.density_field import PatchField
from torchweather.lidar.sensor import Lidar
from torchweather.pipeline.state import PartedState

__all__ = ["LidarAir", "LidarReceiver", "LidarReturns", "LidarScene", "LidarState"]


@dataclass(frozen=True)
class LidarScene:
    """Beams and surfaces in clear air, as the cloud that came in shows them.

    Args:
        points_in: ``(B, N, C)`` the cloud as it came, floating point: x, y, z in metres, intensity, further columns.
        empty_direction: ``(1 or B, N, 3)`` unit vectors for beams without a return, or ``None`` where not known.
        clear_range_m: ``(B, N)`` range of the object; 0 is a beam without return.
        clear_signal: ``(B, N)`` its signal in clear air; 0 for a beam without return.
        integral: ``(B, 1)`` bool, whether the sample's intensities are integers; they then stay integers.
        zero_intensity: ``(B, 1)`` intensity that a value of 0 stands for; ``None`` is 0.
        borrowed_intensity: ``(B, N)`` value of an object in the same or an earlier beam, which a particle takes where
            the column has no meaning (unit ``none``); ``None``: it has one.
        cos_incidence: ``(1 or B, N)`` cosine between the beam and the normal of the surface it meets; ``None`` where
            not known.
        up: ``(1 or B, N)`` upward component of that normal, -1 to 1; ``None`` where not known.
        damp: ``(B, N)`` share of the surface that water can darken; ``None``: all of it.
        pool: ``(B, N)`` share of the surface that lies under smooth water; ``None``: none of it.
        grid: rows and columns of an organised cloud, or ``None``.
    """

    points_in: Tensor
    empty_direction: Tensor | None
    clear_range_m: Tensor
    clear_signal: Tensor
    integral: Tensor
    zero_intensity: Tensor | None = None
    borrowed_intensity: Tensor | None = None
    cos_incidence: Tensor | None = None
    up: Tensor | None = None
    damp: Tensor | None = None
    pool: Tensor | None = None
    grid: tuple[int, int] | None = None


@dataclass(frozen=True)
class LidarAir:
    """Contents of the air, and how far each beam sees them.

    Args:
        reach_m: ``(B, N)`` range to which particles are seen: the object's, or the sensor's maximum where the beam has
            no return but a direction; 0 where it has neither.
        extinction_per_m: ``(B,)`` effective extinction of all weather together; ``None`` is clear air.
        density_scale: ``(B,)`` particles in the air over those that the weather says; ``None`` is 1.
        patches: where about the vehicle the air is dense; ``None`` is everywhere alike.
        extra_m: ``(B, ...)`` extra length of the ways in uniform air of the same optical depth, laid out as
            ``patches``; of all weather together.
        path_density: ``(B, N)`` mean density on each beam's way to ``reach_m`` over that of the weather; ``None`` is 1.
        beam_density: ``(B, N)`` particles along each beam over those of the weather; ``None`` is 1.
        size_factors: ``(B, knots)`` number of particles of each size over that of the weather, at the outlines
            ``beam_particles.SIZE_KNOTS_MM``; ``None`` is 1.
    """

    reach_m: Tensor
    extinction_per_m: Tensor | None = None
    density_scale: Tensor | None = None
    patches: PatchField | None = None
    extra_m: Tensor | None = None
    path_density: Tensor | None = None
    beam_density: Tensor | None = None
    size_factors: Tensor | None = None


@dataclass(frozen=True)
class LidarReturns:
    """Echoes of each beam, and the clouds that go out.

    Args:
        range_m, signal: ``(B, N, E)`` of each echo; echo 0 is the object. After detection: the echoes reported.
        kind: ``(B, N, E)`` int8, ``PointKind`` of each echo.
        points: ``(B, N, C)`` the cloud that goes out; ``None`` until ``to_points``.
        second: ``(B, N, C)`` second returns of a dual-return sensor, likewise.
        echo_speed_m_per_s: ``(B, N, E)`` radial speed of each particle over the ground, positive away from the sensor,
            0 of objects; ``None`` where the sensor measures none. Echoes that an effect adds behind these stand still.
    """

    range_m: Tensor
    signal: Tensor
    kind: Tensor
    points: Tensor | None = None
    second: Tensor | None = None
    echo_speed_m_per_s: Tensor | None = None


@dataclass(frozen=True)
class LidarReceiver:
    """Sensor, threshold and beam.

    Args:
        threshold: ``()`` signal that is detected.
        sensor: the LiDAR; ``None`` until ``to_energy``.
        threshold_scale: ``(B,)`` threshold of the detection over ``threshold``; ``None`` is 1.
        extra_divergence_rad: ``(B,)`` by which the beam is wider than the sensor says, full angle; ``None`` is 0.
        extra_near_full_m, extra_near_power: ``(B,)`` end and power of a further near-range response to particles;
            ``None`` is none.
    """

    threshold: Tensor
    sensor: Lidar | None = None
    threshold_scale: Tensor | None = None
    extra_divergence_rad: Tensor | None = None
    extra_near_full_m: Tensor | None = None
    extra_near_power: Tensor | None = None


@dataclass(frozen=True)
class LidarState(PartedState):
    """Beams of a LiDAR on their way through the chain; B is the flattened batch, E the number of echoes.

    Signals are N/K of ``PHYSICS.md`` 5.3, 1/(m^2 sr): photons over the sensor's system constant. A stage changes
    ``range_m`` and ``signal``; ``to_points`` compares them with their clear-air values, so what no stage touched
    comes out with the input's own bits.
    """

    parts: ClassVar[dict[str, type[Any]]] = {
        "scene": LidarScene,
        "air": LidarAir,
        "returns": LidarReturns,
        "receiver": LidarReceiver,
    }

    scene: LidarScene
    air: LidarAir
    returns: LidarReturns
    receiver: LidarReceiver

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"N": self.scene.points_in.shape[-2]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.scene.points_in.shape[0]

    @property
    def detected_from(self) -> Tensor:
        """``()`` or ``(B, 1)``: signal from which an echo is detected."""
        if self.receiver.threshold_scale is None:
            return self.receiver.threshold
        return self.receiver.threshold * self.receiver.threshold_scale.to(self.receiver.threshold)[:, None]

    @property
    def uniform_m(self) -> Tensor:
        """``(B, N)`` length of uniform air that takes as much as the way to each object."""
        return (
            self.scene.clear_range_m
            if self.air.path_density is None
            else self.scene.clear_range_m * self.air.path_density
        )

    def of_beams(self, part: slice) -> LidarState:
        """The state of a part of the beams, before detection."""
        cut = {name: value[:, part] for name in PER_BEAM if (value := self.field(name)) is not None}
        return self.changed(grid=None, **cut)

    @property
    def direction(self) -> Tensor:
        """``(B, N, 3)`` unit vector of each beam; zero where the input lacks it."""
        range_m = self.scene.clear_range_m[..., None]
        seen = self.scene.points_in[..., :3] / torch.where(range_m > 0, range_m, torch.ones_like(range_m))
        if self.scene.empty_direction is None:
            return seen
        return torch.where(range_m > 0, seen, self.scene.empty_direction.to(seen.dtype))


# Fields of a LidarState that have the beams second.
PER_BEAM = (
    "points_in",
    "borrowed_intensity",
    "empty_direction",
    "clear_range_m",
    "clear_signal",
    "range_m",
    "signal",
    "kind",
    "reach_m",
    "path_density",
    "beam_density",
    "cos_incidence",
    "up",
    "damp",
    "pool",
)

for _part in (LidarScene, LidarAir, LidarReturns, LidarReceiver, LidarState):
    torch.export.register_dataclass(_part, serialized_type_name=f"torchweather.{_part.__name__}")
