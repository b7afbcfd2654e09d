"""The state of a measurement on its way through a chain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum

import torch
from torch import Tensor

from torchweather.sensors import Camera, Lidar, Radar
from torchweather.stages.patchy_air import PatchField
from torchweather.weather import Weather

__all__ = ["CameraState", "LidarState", "PointKind", "RadarState"]


@dataclass(frozen=True)
class CameraState:
    """A camera frame on its way through the chain; B is the flattened batch.

    A frame is a mosaic, C = 1, or a picture of three colour planes, C = 3. Stages treat both alike: a value per colour
    is spread over the pixels by `per_pixel` and broadcast against `by_cells`.

    Args:
        signal: ``(B, C, H, W)`` linear in light, black 0, saturation 1.
        depth_m: ``(B, 1, H, W)`` metres along the optical axis; infinity is sky.
        ray_per_depth: ``(1 or B, 1, H, W)`` length of a pixel's ray per metre of depth, 1 / cos(theta).
        cfa_index: ``(2, 2)`` colour of each cell of a mosaic: 0 red, 1 green or clear, 2 blue; ``None`` for colour
            planes (red, green, blue).
        intrinsics: ``(1 or B, 4)`` fx, fy, cx, cy in pixels.
        airlight: ``(B, 3)`` linear signal of an infinitely deep fog, per colour; ``None`` until a stage sets it.
        fog_extinction_per_m: ``(B, 3)`` extinction of a continuous medium along the ray; ``None`` is clear air.
        transmission: ``(B, 1, H, W)`` share of the scene's light that the continuous medium lets through;
            ``None`` where it is 1 or was not asked for.
        particle_mask: ``(B, 1, H, W)`` share of the exposure in which particles cover the pixel; ``None`` likewise.
        keep_truth: compute ``transmission`` and ``particle_mask`` although the signal needs neither.
        camera: that took the frame; ``None`` where not known.
        normal: ``(1 or B, 3, H, W)`` unit normals of the surfaces in the vehicle's frame, 0 where there is none;
            ``None`` where not known.
        airlight_scale: ``(B, 3)`` light of the sky over the modelled one, per colour; ``None`` is 1.
        extinction_scale: ``(B, 3)`` extinction of fog over the modelled one, per colour; ``None`` is 1.
        fog_density: ``(B, 1, H, W)`` density of fog, mean along each pixel's ray, over that of the weather; ``None``
            is 1.
        particle_count: ``(B,)`` falling particles in the air over those of the weather; ``None`` is 1.
        particle_reach_m: ``(B,)`` depth from which on the air holds none; ``None`` is infinity.
        particle_contrast: ``(B,)`` what particles change in the picture over the modelled; ``None`` is 1.
        path_tangent: ``(B,)`` sideways over downward speed of falling particles, to the right; ``None`` is 0.
        row_time_s: ``(B,)`` from the exposure of a row to that of the row below; ``None`` is 0.
        patches: where about the vehicle the air is dense; ``None`` is everywhere alike.
        ray_in_layer_m: ``(1 or B, 1, H, W)`` length of each pixel's ray up to the top of the fog, metres
            (``PHYSICS.md`` 10.11); ``None``: fog has no top.
        sky: ``(1 or B, 1, H, W)`` share of each pixel that shows the sky; ``None``: where the depth is infinite.
        near_mask: ``(1 or B, 1, H, W)`` share of each pixel that shows the own vehicle, with no weather in front of it;
            ``None``: nowhere.
        sine_elevation: ``(1 or B, 1, H, W)`` sine of each ray's elevation above the horizon; ``None`` where not known.
    """

    signal: Tensor
    depth_m: Tensor
    ray_per_depth: Tensor
    cfa_index: Tensor | None
    intrinsics: Tensor
    airlight: Tensor | None = None
    fog_extinction_per_m: Tensor | None = None
    transmission: Tensor | None = None
    particle_mask: Tensor | None = None
    keep_truth: bool = False
    camera: Camera | None = None
    normal: Tensor | None = None
    airlight_scale: Tensor | None = None
    extinction_scale: Tensor | None = None
    fog_density: Tensor | None = None
    particle_count: Tensor | None = None
    particle_reach_m: Tensor | None = None
    particle_contrast: Tensor | None = None
    path_tangent: Tensor | None = None
    row_time_s: Tensor | None = None
    patches: PatchField | None = None
    ray_in_layer_m: Tensor | None = None
    sky: Tensor | None = None
    near_mask: Tensor | None = None
    sine_elevation: Tensor | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"C": self.signal.shape[1], "H": self.signal.shape[-2], "W": self.signal.shape[-1]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.signal.shape[0]

    @property
    def ray_length_m(self) -> Tensor:
        """``(B, 1, H, W)`` distance along each pixel's ray, metres."""
        return self.depth_m * self.ray_per_depth

    @property
    def one_plane(self) -> Tensor:
        """``(B, 1, H, W)`` the signal's first plane: the shape, dtype and device of what all colours share."""
        return self.signal[:, :1]

    def fog_path_m(self, depth_m: Tensor, rows: slice = slice(None)) -> Tensor:
        """Length of each pixel's ray inside the fog, metres: to its surface, or to the top of the layer.

        Args:
            depth_m: ``(B, 1, rows, W)`` depth in these rows.
            rows: of the frame.
        """
        length_m = depth_m * self.ray_per_depth[..., rows, :]
        if self.ray_in_layer_m is None:
            return length_m
        return torch.minimum(length_m, self.ray_in_layer_m[..., rows, :])

    def per_pixel(self, per_colour: Tensor) -> Tensor:
        """Spread a value per colour ``(B, 3)`` over the pixels, to be broadcast against ``by_cells``.

        Of a mosaic it is one row pair, ``(B, 1, 1, 2, W)``; of colour planes ``(B, 3, 1, 1, 1)``.
        """
        if self.cfa_index is None:
            return per_colour[:, :, None, None, None]
        cell = per_colour[:, self.cfa_index]  # (B, 2, 2)
        row_pair = cell.repeat(1, 1, self.signal.shape[-1] // 2)  # (B, 2, W)
        return row_pair[:, None, None]

    def by_cells(self, image: Tensor) -> Tensor:
        """View ``(B, C, H, W)`` with the rows of the CFA's cells apart; ``flatten(2, 3)`` takes it back.

        Of a mosaic it is ``(B, C, H/2, 2, W)``; of colour planes ``(B, C, 1, H, W)``.
        """
        b, c, h, w = image.shape
        return image[:, :, None] if self.cfa_index is None else image.reshape(b, c, h // 2, 2, w)


class PointKind(IntEnum):
    """What a point of the output is.

    Example:
        >>> PointKind(1).name
        'PARTICLE'
    """

    OBJECT = 0
    """A return of the scene, weakened by the weather."""
    PARTICLE = 1
    """A return of a drop, a flake or of fog."""
    LOST = 2
    """No return: the object's went under the threshold, or the beam had none to begin with."""


@dataclass(frozen=True)
class LidarState:
    """Beams of a LiDAR on their way through the chain; B is the flattened batch, E the number of echoes.

    Signals are N/K of ``PHYSICS.md`` 5.3, 1/(m^2 sr): photons over the sensor's system constant. A stage changes
    ``range_m`` and ``signal``; ``to_points`` compares them with their clear-air values, so what no stage touched
    comes out with the input's own bits.

    Args:
        points_in: ``(B, N, C)`` the cloud as it came, floating point: x, y, z in metres, intensity, further columns.
        empty_direction: ``(1 or B, N, 3)`` unit vectors for beams without a return, or ``None`` where not known.
        clear_range_m: ``(B, N)`` range of the object; 0 is a beam without return.
        clear_signal: ``(B, N)`` its signal in clear air; 0 for a beam without return.
        range_m, signal: ``(B, N, E)`` of each echo; echo 0 is the object. After detection: the echoes reported.
        kind: ``(B, N, E)`` int8, ``PointKind`` of each echo.
        reach_m: ``(B, N)`` range to which particles are seen: the object's, or the sensor's maximum where the beam has
            no return but a direction; 0 where it has neither.
        threshold: ``()`` signal that is detected.
        integral: ``(B, 1)`` bool, whether the sample's intensities are integers; they then stay integers.
        zero_intensity: ``(B, 1)`` intensity that a value of 0 stands for; ``None`` is 0.
        extinction_per_m: ``(B,)`` effective extinction of all weather together; ``None`` is clear air.
        density_scale: ``(B,)`` particles in the air over those that the weather says; ``None`` is 1.
        patches: where about the vehicle the air is dense; ``None`` is everywhere alike.
        extra_m: ``(B, ...)`` by how much longer the ways would be in uniform air, laid out as ``patches``; of all
            weather together.
        path_density: ``(B, N)`` mean density on each beam's way to ``reach_m`` over that of the weather; ``None`` is 1.
        beam_density: ``(B, N)`` particles along each beam over those of the weather; ``None`` is 1.
        size_factors: ``(B, knots)`` number of particles of each size over that of the weather, at the outlines
            ``beam_particles.SIZE_KNOTS_MM``; ``None`` is 1.
        extra_divergence_rad: ``(B,)`` by which the beam is wider than the sensor says, full angle; ``None`` is 0.
        threshold_scale: ``(B,)`` threshold of the detection over ``threshold``; ``None`` is 1.
        cos_incidence: ``(1 or B, N)`` cosine between the beam and the normal of the surface it meets; ``None`` where
            not known.
        up: ``(1 or B, N)`` upward component of that normal, -1 to 1; ``None`` where not known.
        grid: rows and columns of an organised cloud, or ``None``.
        sensor: the LiDAR; ``None`` until ``to_energy``.
        points: ``(B, N, C)`` the cloud that goes out; ``None`` until ``to_points``.
        second: ``(B, N, C)`` second returns of a dual-return sensor, likewise.
    """

    points_in: Tensor
    empty_direction: Tensor | None
    clear_range_m: Tensor
    clear_signal: Tensor
    range_m: Tensor
    signal: Tensor
    kind: Tensor
    reach_m: Tensor
    threshold: Tensor
    integral: Tensor
    extinction_per_m: Tensor | None = None
    density_scale: Tensor | None = None
    patches: PatchField | None = None
    extra_m: Tensor | None = None
    path_density: Tensor | None = None
    extra_divergence_rad: Tensor | None = None
    threshold_scale: Tensor | None = None
    cos_incidence: Tensor | None = None
    up: Tensor | None = None
    grid: tuple[int, int] | None = None
    sensor: Lidar | None = None
    points: Tensor | None = None
    second: Tensor | None = None
    zero_intensity: Tensor | None = None
    beam_density: Tensor | None = None
    size_factors: Tensor | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"N": self.points_in.shape[-2]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.points_in.shape[0]

    @property
    def detected_from(self) -> Tensor:
        """``()`` or ``(B, 1)``: signal from which an echo is detected."""
        if self.threshold_scale is None:
            return self.threshold
        return self.threshold * self.threshold_scale.to(self.threshold)[:, None]

    @property
    def uniform_m(self) -> Tensor:
        """``(B, N)`` length of uniform air that takes as much as the way to each object."""
        return self.clear_range_m if self.path_density is None else self.clear_range_m * self.path_density

    def of_beams(self, part: slice) -> LidarState:
        """The state of a part of the beams, before detection."""
        cut = {name: value[:, part] for name in PER_BEAM if (value := getattr(self, name)) is not None}
        return replace(self, grid=None, **cut)

    @property
    def direction(self) -> Tensor:
        """``(B, N, 3)`` unit vector of each beam; zero where the input does not tell it."""
        range_m = self.clear_range_m[..., None]
        seen = self.points_in[..., :3] / torch.where(range_m > 0, range_m, torch.ones_like(range_m))
        if self.empty_direction is None:
            return seen
        return torch.where(range_m > 0, seen, self.empty_direction.to(seen.dtype))


# Fields of a LidarState that have the beams second.
PER_BEAM = (
    "points_in",
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
)


@dataclass(frozen=True)
class RadarState:
    """Detections of a radar on their way through the chain; B is the flattened batch.

    A stage changes ``gain_db``, which is 0 in clear air; where it still is, the input comes out with its own bits.

    Args:
        points_in: ``(B, N, C)`` the list as it came, floating point: x, y, z in metres, radial speed in m/s, power in
            dB, radar cross section in dBsm, further columns.
        range_m: ``(B, N)`` of each; 0 is no detection.
        gain_db: ``(B, N)`` what the weather does to the power of each; 0 or less but for effects.
        kind: ``(B, N)`` int8, ``PointKind`` of each.
        noise_floor_db: ``(B,)`` in the unit of the power column.
        detection_snr_db: ``()`` from which a target is detected.
        attenuation_db_per_km: ``(B,)`` of the air, one way.
        cover_loss_db: ``(B,)`` of the radar's cover, both ways together.
        snr_db: ``(B, N + K)`` signal over the noise floor; ``None`` until the detection.
        clutter: ``(B, K, 6)`` detections of the weather itself, columns as the first six of ``points_in``; ``None``
            without.
        clutter_valid: ``(B, K)`` bool, which of them are there.
        points: ``(B, N + K, C)`` the list that goes out; ``None`` until ``to_radar_points``.
        sensor: the radar; ``None`` until ``path_attenuation``, and so the next two.
        weathers: the weather with its rates at 0.
        rates_mm_per_h: kind of precipitation to its rates, ``(B,)``.
        ego_speed_m_per_s: of the vehicle, forward.
        noise_shift_db: ``(B,)`` by which the noise floor lies above ``noise_floor_db``; ``None`` is 0.
        threshold_shift_db: ``(B,)`` by which the SNR that is detected lies above ``detection_snr_db``; ``None`` is 0.
        pattern_tilt_rad: ``(B,)`` by which the antenna's pattern is turned, from x to y; ``None`` is 0.
        speed_std_m_per_s: ``(B,)`` by which measured speeds scatter more; ``None`` is 0.
        target_class: ``(1 or B, N)`` whole numbers, below 0 where not known; ``None`` where none is.
        frame_number: ``(B,)`` of the frame in its recording, from 0; ``None`` where not known.
        patches, extra_m: where about the vehicle the air is dense, as of a LiDAR; ``None`` is everywhere alike.
        past_rain_mm_per_h, past_rain_min: ``(B, T)`` rates of earlier rain, and how many minutes ago; ``None`` where no
            such rain is known of.
    """

    points_in: Tensor
    range_m: Tensor
    gain_db: Tensor
    kind: Tensor
    noise_floor_db: Tensor
    detection_snr_db: Tensor
    attenuation_db_per_km: Tensor
    cover_loss_db: Tensor
    snr_db: Tensor | None = None
    clutter: Tensor | None = None
    clutter_valid: Tensor | None = None
    points: Tensor | None = None
    sensor: Radar | None = None
    weathers: tuple[Weather, ...] | None = None
    rates_mm_per_h: Mapping[str, Tensor] | None = None
    ego_speed_m_per_s: float = 0.0
    noise_shift_db: Tensor | None = None
    threshold_shift_db: Tensor | None = None
    pattern_tilt_rad: Tensor | None = None
    speed_std_m_per_s: Tensor | None = None
    target_class: Tensor | None = None
    frame_number: Tensor | None = None
    patches: PatchField | None = None
    extra_m: Tensor | None = None
    past_rain_mm_per_h: Tensor | None = None
    past_rain_min: Tensor | None = None

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        return {"N": self.points_in.shape[-2]}

    @property
    def batch(self) -> int:
        """Number of samples."""
        return self.points_in.shape[0]

    @property
    def floor_db(self) -> Tensor:
        """``(B,)`` noise floor of the frame, effects and all."""
        return self.noise_floor_db if self.noise_shift_db is None else self.noise_floor_db + self.noise_shift_db

    @property
    def detected_from_db(self) -> Tensor:
        """``(B,)`` power from which a target is detected."""
        level = self.floor_db + self.detection_snr_db
        return level if self.threshold_shift_db is None else level + self.threshold_shift_db


for _state in (PatchField, CameraState, LidarState, RadarState):
    torch.export.register_dataclass(_state, serialized_type_name=f"torchweather.{_state.__name__}")
