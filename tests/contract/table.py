"""Every transform in every kind of weather, each with its input and the tolerances of its numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow, Weather
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import MapAxes, PowerScale
from torchweather.sensors import Camera, Lidar, Radar
from torchweather.transforms import (
    AsBayer,
    BayerFog,
    BayerRain,
    BayerSnow,
    BayerWeather,
    LidarFog,
    LidarRain,
    LidarSnow,
    LidarWeather,
    RadarAttenuation,
)

H, W = 24, 32
LIGHT = (0.5, 0.6, 0.7)
CAMERA = Camera.from_intrinsics(300.0, 300.0, 15.5, 11.5, W, H)
TILTED = Camera.from_intrinsics(300.0, 290.0, 15.0, 11.0, W, H, roll_rad=0.2, pitch_rad=0.1, k1=-0.1, p1=1e-3)
SEEN: dict[str, Any] = {"depth": 25.0, "airlight": LIGHT, "far_m": 40.0}

# Overlap from 1 to 3 m: rain returns too, fog not in every beam, and every kind of output occurs in a small cloud.
LIDAR = Lidar(
    wavelength_nm=905.0,
    near_start_m=1.0,
    near_full_m=3.0,
    range_noise_m=0.02,
    range_resolution_m=0.002,
    intensity_unit="uint8_linear",
)
POINTS, EMPTY = 400, slice(0, 40)

# A floor in the middle of the powers below: of a small list some are lost, some stand on it, and rain is seen itself.
RADAR = replace(Radar.preset("imaging-77ghz"), noise_floor_db=-130.0)
THRESHOLD_DB, ROWS, CLUTTER_ROWS = -118.0, 300, 24
CLUTTER: dict[str, Any] = {"clutter": True, "clutter_points": CLUTTER_ROWS, "radome_film_db": 0.8}
NO_DETECTION, FLOORED = slice(0, 20), slice(20, 80)

SPEEDS = tuple(-2.0 + 0.5 * k for k in range(8))
ANGLES = tuple(math.radians(a) for a in range(-40, 41, 20))
RANGES = tuple(0.5 + 1.0 * k for k in range(30))
TURN = MapAxes.of_turn(bins=30, bin_m=1.0, azimuths=40)
TENSOR4 = MapAxes(("doppler", "range", "elevation", "azimuth"), RANGES, ANGLES, (-0.1, 0.0, 0.1), SPEEDS)

HALVES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
IMAGES = (torch.uint8, torch.uint16, torch.float16, torch.float32, torch.float64)


def frame(*batch: int, dtype: torch.dtype = torch.float32, seed: int = 0, channels: int = 1) -> Tensor:
    """Raw frames up to 0.6 of full scale, 12 bit in 16; or images of three colours."""
    random = torch.Generator().manual_seed(seed)
    values = torch.rand((*batch, channels, H, W), generator=random, dtype=torch.float64) * 0.6
    if dtype == torch.uint8:
        return (values * 255).to(dtype)
    if dtype == torch.uint16:
        return (values * (4095 if channels == 1 else 65535)).to(torch.int32).to(dtype)
    return values.to(dtype)


def image(*batch: int, dtype: torch.dtype = torch.float32, seed: int = 0) -> Tensor:
    return frame(*batch, dtype=dtype, seed=seed, channels=3)


def cloud(
    *batch: int, columns: int = 5, dtype: torch.dtype = torch.float32, seed: int = 0, scale: float = 255
) -> Tensor:
    """Objects at 0.5 to 100 m, every fifth of intensity 0, and 40 rows without return, one of them not dark."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn((*batch, POINTS, columns), generator=generator)
    span = torch.rand((*batch, POINTS, 1), generator=generator)
    points[..., :3] *= 0.5 * 200.0**span / points[..., :3].norm(dim=-1, keepdim=True)
    points[..., EMPTY, :3] = 0.0
    intensity = torch.rand((*batch, POINTS), generator=generator).square() * scale
    intensity[..., ::5] = 0.0
    intensity[..., EMPTY] = 0.0
    intensity[..., 3] = 0.5 * scale
    points[..., 3] = intensity if scale <= 1 else intensity.floor()
    return points.to(dtype)


def rays(*batch: int, seed: int = 5) -> Tensor:
    """Directions of the beams of a cloud."""
    random = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn((*batch, POINTS, 3), generator=random), dim=-1)


def detections(*batch: int, columns: int = 7, dtype: torch.dtype = torch.float32, seed: int = 0) -> Tensor:
    """Targets at 2 to 150 m; 20 rows without detection, one of them not blank; 60 below the threshold."""
    random = torch.Generator().manual_seed(seed)
    points = torch.randn((*batch, ROWS, columns), generator=random)
    span = torch.rand((*batch, ROWS, 1), generator=random)
    points[..., :3] *= 2.0 * 75.0**span / points[..., :3].norm(dim=-1, keepdim=True)
    points[..., 4] = THRESHOLD_DB + 0.25 + 20.0 * torch.rand((*batch, ROWS), generator=random).square()
    points[..., FLOORED, 4] = -125.0
    points[..., 5] *= 10.0
    points[..., NO_DETECTION, :] = 0.0
    points[..., 3, 3:6] = torch.tensor([1.5, -50.0, 3.0])
    return points.to(dtype)


def power_map(
    *batch: int, axes: MapAxes = TURN, kind: str = "linear", dtype: torch.dtype | None = None, seed: int = 0
) -> Tensor:
    """Noise in the cells of a map, in any of the scales."""
    generator = torch.Generator().manual_seed(seed)
    size = (*batch, *axes.shape)
    if kind == "db_steps":
        return torch.randint(0, 256, size, generator=generator, dtype=torch.uint8)
    field = torch.view_as_complex(torch.randn(*size, 2, generator=generator))
    power = field.abs().square()
    found = {"complex": field, "linear": power, "amplitude": power.sqrt(), "db": 10.0 * power.log10()}[kind]
    return found if dtype is None else found.to(dtype)


def map_weather(weather: Any, axes: MapAxes = TURN, kind: str = "linear", **more: Any) -> RadarMapWeather:
    """Weather on maps of a small radar."""
    scale = PowerScale.steps(0.5) if kind == "db_steps" else PowerScale(kind)
    options = {"noise_floor_db": 10.0 if kind == "db_steps" else 3.0, **more}
    return RadarMapWeather(weather, Radar.preset("awr1843-like"), axes=axes, scale=scale, **options)


@dataclass(frozen=True)
class Entry:
    """A transform in one kind of weather.

    Args:
        make: the transform, of a weather and options.
        data: an input, of a batch shape and, by keyword, ``dtype`` and ``seed``.
        weather: weather of an intensity (rate or visibility).
        intensities: some; the first shows in ``data``.
        none: the intensity at which nothing falls; ``None`` where other parts of a mixture fall still.
        dtypes: of inputs.
        apart: largest difference that a dtype's rounding explains, absolute and relative.
        beside: tensors that go beside the input, by keyword, of a batch shape.
        more_rows: rows that leave beside those that come.
    """

    make: Callable[..., Any]
    data: Callable[..., Tensor]
    weather: Callable[[Any], Weather]
    intensities: tuple[float, float, float]
    none: float | None
    dtypes: tuple[torch.dtype, ...]
    apart: Callable[[torch.dtype], float]
    beside: Callable[..., dict[str, Tensor]] = field(default=lambda *batch: {})
    more_rows: int = 0
    random: bool = True

    def built(self, intensity: Any = None, **options: Any) -> Any:
        """The transform at an intensity."""
        return self.make(self.weather(self.intensities[0] if intensity is None else intensity), **options)

    def at(self, weather: Any, **options: Any) -> Any:
        """The transform of the same sensor in another weather."""
        return self.built().with_weather(weather) if not options else self.make(weather, **options)

    @property
    def calm(self) -> Weather:
        """Nothing of what this weather is made of."""
        parts = self.weather(self.intensities[0]).parts
        still = [Fog(math.inf) if part.kind == "fog" else replace(part, rate_mm_per_h=0.0) for part in parts]
        return still[0] if len(still) == 1 else Mixture(*still)


def rain(intensity: Any) -> Weather:
    return Rain(intensity)


def snow(intensity: Any) -> Weather:
    return Snow(intensity)


def fog(intensity: Any) -> Weather:
    return Fog(intensity)


def wet_snow(intensity: Any) -> Weather:
    return Snow(intensity, melt_fraction=0.5)


def of_camera(intensity: Any) -> Weather:
    return Mixture(Snow(1.0), Fog(intensity, patch_log_std=0.5), Rain(10.0, patch_log_std=0.3, patch_length_m=30.0))


def of_lidar(intensity: Any) -> Weather:
    return Mixture(Snow(1.0), Fog(intensity), Rain(10.0))


def of_radar(intensity: Any) -> Weather:
    return Mixture(Snow(2.0, melt_fraction=0.3, patch_log_std=0.4), Fog(intensity), Rain(40.0))


def of_map(intensity: Any) -> Weather:
    return Mixture(Rain(intensity), Snow(2.0, melt_fraction=0.3))


def of_image(dtype: torch.dtype) -> float:
    """Half a step of the dtype, and the float32 of the way."""
    return {torch.uint8: 0.5 / 255, torch.uint16: 0.5 / 4095, torch.float16: 5e-4}.get(dtype, 0.0) + 2e-5


def of_points(dtype: torch.dtype) -> float:
    # A float64 cloud is computed in float64: where a beam lies on the border of two cells of a table, which of them it
    # takes depends on the processor's rounding, and a particle stands some millimetres elsewhere.
    return 5e-3 if dtype == torch.float64 else 1e-4


def _camera(
    kind: Any, weather: Any, intensities: Any, none: Any, camera: Camera = CAMERA, random: bool = True
) -> Entry:
    def make(weather: Weather, *, sensor: Camera = camera, **options: Any) -> BayerWeather:
        made: BayerWeather = kind(weather, sensor, **{**SEEN, **options})
        return made

    def depth(*batch: int) -> dict[str, Tensor]:
        depth_m = torch.full((*batch, 1, H, W), 20.0)
        depth_m[..., :4, :] = math.inf
        return {"depth": depth_m}

    return Entry(make, frame, weather, intensities, none, IMAGES, of_image, depth, random=random)


def _rgb(weather: Any, intensities: Any, none: Any, random: bool = True) -> Entry:
    def make(weather: Weather, **options: Any) -> AsBayer:
        return AsBayer(BayerWeather(weather, CAMERA, **{**SEEN, **options}))

    return Entry(make, image, weather, intensities, none, IMAGES, of_image, random=random)


def _lidar(kind: Any, mode: str, weather: Any, intensities: Any, none: Any) -> Entry:
    def make(weather: Weather, *, sensor: Lidar = LIDAR, **options: Any) -> LidarWeather:
        made: LidarWeather = kind(weather, replace(sensor, return_mode=mode), **options)
        return made

    return Entry(
        make, cloud, weather, intensities, none, HALVES, of_points, lambda *batch: {"directions": rays(*batch)}
    )


def _radar(weather: Any, intensities: Any, none: Any, more_rows: int = 0) -> Entry:
    def make(weather: Weather, *, sensor: Radar = RADAR, **options: Any) -> RadarAttenuation:
        return RadarAttenuation(weather, sensor, **{**(CLUTTER if more_rows else {}), **options})

    return Entry(make, detections, weather, intensities, none, HALVES, of_points, more_rows=more_rows)


def _map(axes: MapAxes, kind: str, weather: Any, none: Any) -> Entry:
    def make(weather: Weather, **options: Any) -> RadarMapWeather:
        return map_weather(weather, axes, kind, **options)

    def data(*batch: int, dtype: torch.dtype | None = None, seed: int = 0) -> Tensor:
        return power_map(*batch, axes=axes, kind=kind, dtype=None if kind == "db_steps" else dtype, seed=seed)

    own = {"complex": torch.complex64, "db_steps": torch.uint8}.get(kind, torch.float32)
    return Entry(make, data, weather, (30.0, 7.0, 60.0), none, (own,), of_points)


TABLE: dict[str, Entry] = {
    "BayerRain": _camera(BayerRain, rain, (30.0, 1.0, 60.0), 0.0),
    "BayerSnow": _camera(BayerSnow, snow, (2.0, 0.1, 5.0), 0.0),
    "BayerFog": _camera(BayerFog, fog, (60.0, 20.0, 900.0), math.inf, random=False),
    "BayerWeather": _camera(BayerWeather, of_camera, (60.0, 20.0, 900.0), None),
    "AsBayer of rain": _rgb(rain, (30.0, 1.0, 60.0), 0.0),
    "AsBayer of fog": _rgb(fog, (60.0, 20.0, 900.0), math.inf, random=False),
    "LidarRain": _lidar(LidarRain, "strongest", rain, (60.0, 0.0, 7.0), 0.0),
    "LidarSnow": _lidar(LidarSnow, "strongest", snow, (3.0, 0.1, 5.0), 0.0),
    "LidarFog": _lidar(LidarFog, "strongest", fog, (1500.0, 40.0, math.inf), math.inf),
    "LidarWeather": _lidar(LidarWeather, "strongest", of_lidar, (5000.0, 40.0, 900.0), None),
    "LidarRain, dual": _lidar(LidarRain, "dual", rain, (60.0, 0.0, 7.0), 0.0),
    "LidarWeather, dual": _lidar(LidarWeather, "dual", of_lidar, (5000.0, 40.0, 900.0), None),
    "LidarWeather, first": _lidar(LidarWeather, "first", of_lidar, (5000.0, 40.0, 900.0), None),
    "LidarWeather, last": _lidar(LidarWeather, "last", of_lidar, (5000.0, 40.0, 900.0), None),
    "RadarAttenuation in rain": _radar(rain, (60.0, 0.0, 7.0), 0.0),
    "RadarAttenuation in wet snow": _radar(wet_snow, (5.0, 0.1, 1.0), 0.0),
    "RadarAttenuation in fog": _radar(fog, (12.0, 15.0, math.inf), math.inf),
    "RadarAttenuation, rain seen": _radar(rain, (60.0, 0.0, 7.0), 0.0, CLUTTER_ROWS),
    "RadarAttenuation, mixture seen": _radar(of_radar, (30.0, 9.0, 1e4), None, 2 * CLUTTER_ROWS),
    "RadarMapWeather": _map(TURN, "linear", rain, 0.0),
    "RadarMapWeather of steps": _map(TURN, "db_steps", rain, 0.0),
    "RadarMapWeather of four axes": _map(TENSOR4, "complex", of_map, None),
}
# One of each class and sensor, with an effect in every input.
ONE_EACH = (
    "BayerRain",
    "AsBayer of rain",
    "LidarRain",
    "LidarRain, dual",
    "RadarAttenuation, rain seen",
    "RadarMapWeather",
)


@cache
def transform_of(name: str) -> Any:
    """The transform of an entry; tests leave it as it is."""
    return TABLE[name].built()


def tensors_of(result: Any) -> dict[str, Tensor]:
    """The tensors of a result."""
    return {name: value for name, value in vars(result).items() if isinstance(value, Tensor)}


def same_bits(one: Tensor, other: Tensor) -> bool:
    """Bit for bit: 0 and -0 differ, a NaN equals itself."""
    first, second = (torch.view_as_real(v) if v.is_complex() else v for v in (one, other))
    size = (first.dtype, first.shape) == (second.dtype, second.shape)
    bits = [value.reshape(-1).contiguous().view(torch.uint8) for value in (first, second)]
    return size and torch.equal(*bits)


def same_result(one: Any, other: Any) -> bool:
    """All tensors of two results, bit for bit."""
    first, second = tensors_of(one), tensors_of(other)
    return first.keys() == second.keys() and all(same_bits(value, second[name]) for name, value in first.items())
