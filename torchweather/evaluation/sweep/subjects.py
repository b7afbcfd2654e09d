"""Subject of a sweep: one sensor's clear data, how it is rendered, and how it is scored."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Weather
from torchweather.camera.depth import EXACT, SceneDepth
from torchweather.camera.levels import raw_to_linear
from torchweather.camera.rgb import AsBayer
from torchweather.camera.sensor import Camera
from torchweather.camera.tone import normalise
from torchweather.camera.transform import BayerWeather
from torchweather.core.arguments import check_arguments, check_options
from torchweather.lidar.sensor import Lidar
from torchweather.lidar.transform import LidarResult, LidarWeather
from torchweather.metrics import CLOUD_SCORES, IMAGE_SCORES, Region, bayer_scores, cloud_scores, image_scores
from torchweather.metrics.clouds import there
from torchweather.metrics.shape_signature import shape_signature
from torchweather.radar import FmcwRadar, Scatterers
from torchweather.radar.sensor import Radar
from torchweather.radar.transform import RadarAttenuation

__all__ = ["CameraSubject", "LidarSubject", "RadarSceneSubject", "RadarSubject", "Subject"]

# Lower is better in all of them.
CLOUD_DIRECTIONS = dict.fromkeys(CLOUD_SCORES, "down")
IMAGE_DIRECTIONS = {name: "up" if facts.higher_is_better else "down" for name, facts in IMAGE_SCORES.items()}


class Subject(Protocol):
    """One sensor's clear data.

    ``name`` is its own, ``scene`` that of all that are judged together: of the frames of a folder, the folder's.
    ``directions`` says of every score whether higher is better (``up``) or lower (``down``).
    """

    sensor: ClassVar[str]
    directions: ClassVar[Mapping[str, str]]

    @property
    def name(self) -> str:
        """Of this frame or cloud."""

    @property
    def scene(self) -> str:
        """Of all that are judged together."""

    @property
    def indoors(self) -> bool:
        """It neither rains nor snows there."""

    def render(self, weather: Weather, seed: int) -> Tensor:
        """The data in a weather drawn with a seed."""

    def score(self, distorted: Tensor, names: Sequence[str]) -> dict[str, float]:
        """Scores of rendered data against the clear ones."""

    def facts(self, distorted: Tensor | None) -> dict[str, float]:
        """Plain quantities that explain scores, of rendered data or of the clear ones (``None``)."""


@dataclass(frozen=True, eq=False)
class CameraSubject:
    """A camera's frame with its depth.

    A raw frame is scored as its colour image: linear light of the mosaic, clipped to [0, 1], demosaiced, sRGB-encoded
    (``bayer_scores``). An RGB frame is scored as it is.

    Args:
        name: of the frame.
        data: mosaic ``(1, H, W)`` or RGB ``(3, H, W)``; all fourteen scores take 161 pixels a side.
        depth_m: ``(1, H, W)`` metres along the optical axis, infinite for the sky.
        camera: of the size of the frame.
        scene: of the frames that are judged together; empty: the frame alone.
        indoors: it neither rains nor snows there.
        options: of ``BayerWeather``, such as ``airlight``.
        through_mosaic: take RGB frames, the clear one too, through the camera's mosaic and back.
        scene_depth: what a depth source knows beside ``depth_m``: sky, own vehicle, confidence.

    Note:
        The frame's own noise is in the clear and in the rendered data alike: a score of raw frames sees the weather
        alone. An RGB frame is weathered in linear light without a mosaic, so its scores see the weather alone, too.

    Example:
        >>> camera = Camera.preset("lucid-triton").resized(16, 16)
        >>> subject = CameraSubject("grey", torch.full((1, 16, 16), 0.3), torch.full((1, 16, 16), 40.0), camera,
        ...     options={"airlight": 0.8})
        >>> from torchweather.atmosphere.weather import Fog
        >>> [round(subject.score(subject.render(Fog(mor_m=mor), 0), ["psnr"])["psnr"], 1) for mor in (400.0, 100.0)]
        [18.8, 11.8]
    """

    name: str
    data: Tensor
    depth_m: Tensor
    camera: Camera
    scene: str = ""
    indoors: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)
    scene_depth: SceneDepth | None = None
    through_mosaic: bool = False

    sensor: ClassVar[str] = "camera"
    directions: ClassVar[Mapping[str, str]] = IMAGE_DIRECTIONS

    def __post_init__(self) -> None:
        check_arguments(
            "CameraSubject(name: str, data: Tensor, depth_m: Tensor, camera: Camera, scene: str, indoors: bool, "
            "options: Mapping[str], scene_depth: SceneDepth | None, through_mosaic: bool)",
            self.name,
            self.data,
            self.depth_m,
            self.camera,
            self.scene,
            self.indoors,
            self.options,
            self.scene_depth,
            self.through_mosaic,
        )
        object.__setattr__(self, "scene", self.scene or self.name)
        check_options("CameraSubject", BayerWeather, self.options)

    @property
    def depth_confidence(self) -> str:
        """Confidence of the depth: ``exact``, ``measured``, ``completed`` or ``guessed``."""
        return EXACT if self.scene_depth is None else self.scene_depth.confidence

    @property
    def label_shape(self) -> tuple[int, ...]:
        """Of a class for each pixel."""
        return tuple(self.data.shape[-2:])

    @property
    def is_rgb(self) -> bool:
        """True for a colour image, False for a mosaic."""
        return self.data.shape[-3] == 3

    @property
    def reference(self) -> Tensor:
        """The clear frame that frames in weather are compared with; by way of the mosaic where they went that way."""
        if not (self.is_rgb and self.through_mosaic):
            return self.data
        clear_air = BayerWeather(Fog(mor_m=math.inf), self.camera)
        return AsBayer(clear_air, through_mosaic=True).without_weather(self.data)

    def render(self, weather: Weather, seed: int, effects: Sequence[Mapping[str, Any]] = ()) -> Tensor:
        """The frame in a weather, in its own format; ``effects`` come beside those of the options."""
        transform = BayerWeather(weather, self.camera, **_with_effects(self.options, effects))
        taker = AsBayer(transform, through_mosaic=self.through_mosaic) if self.is_rgb else transform
        with torch.no_grad():
            depth = self.depth_m if self.scene_depth is None else self.scene_depth
            found: Tensor = taker(self.data, depth, taker.draw(self.data, seed=seed))
        return found

    def score(self, distorted: Tensor, names: Sequence[str]) -> dict[str, float]:
        """Image scores against the clear frame."""
        first, second = self._light(distorted), self._light(self.reference)
        with torch.no_grad():
            if self.is_rgb:
                found = image_scores(first, second, names)
            else:
                found = bayer_scores(first, second, names, pattern=self.camera.bayer_pattern)
        return {name: float(score) for name, score in found.items()}

    def facts(self, distorted: Tensor | None) -> dict[str, float]:
        """Mean and contrast (standard deviation) of what is in [0, 1]."""
        light = self._light(self.reference if distorted is None else distorted).double()
        return {"mean": float(light.mean()), "contrast": float(light.std())}

    def _light(self, data: Tensor) -> Tensor:
        light = normalise(data) if self.is_rgb else raw_to_linear(data, self.camera, self)
        return light.clamp(0.0, 1.0)


@dataclass(frozen=True, eq=False)
class _Points:
    """Points that are scored by their distances to the clear ones.

    Args:
        name: of the cloud.
        scene: of the clouds that are judged together; empty: the cloud alone.
        indoors: it neither rains nor snows there.
        region: points outside are not scored.
    """

    name: str
    scene: str = ""
    indoors: bool = False
    region: Region | None = None

    directions: ClassVar[Mapping[str, str]] = CLOUD_DIRECTIONS
    depth_confidence: ClassVar[str] = ""
    """Points need no depth."""

    def __post_init__(self) -> None:
        check_arguments("Subject(name: str, scene: str, region: Region | None)", self.name, self.scene, self.region)
        object.__setattr__(self, "scene", self.scene or self.name)

    @property
    def clear(self) -> Tensor:
        """The points in clear air."""
        raise NotImplementedError

    def score(self, distorted: Tensor, names: Sequence[str]) -> dict[str, float]:
        """Cloud scores of the points that are there against the clear ones."""
        found = cloud_scores(distorted, self.clear, names=list(names), region=self.region)
        return {name: float(score) for name, score in found.items()}

    def facts(self, distorted: Tensor | None) -> dict[str, float]:
        """Number of points, mean distance between two of them, and their median range."""
        cloud = self.clear if distorted is None else distorted
        points = cloud[there(cloud, region=self.region)][:, :3].double()
        found = {"points": float(len(points))}
        if len(points) > 1:
            found["pair_distance_m"] = float(shape_signature(points).mean())
            found["range_m"] = float(torch.linalg.vector_norm(points, dim=-1).median())
        return found


@dataclass(frozen=True, eq=False)
class LidarSubject(_Points):
    """A LiDAR's cloud.

    Args:
        name, scene, indoors, region: as in every cloud.
        points: ``(N, 4 or more)`` x, y, z in metres, intensity in the sensor's unit.
        lidar: the sensor.
        beams: ``(N, 3)`` directions of the rows, where known: then empty beams can return light too.
        options: of ``LidarWeather``.

    Example:
        >>> wall = torch.tensor([[20.0, 0.1 * k, 0.0, 30.0] for k in range(200)])
        >>> subject = LidarSubject("wall", points=wall, lidar=Lidar.preset("ouster-os1-128"))
        >>> from torchweather.atmosphere.weather import Fog
        >>> scores = [subject.score(subject.render(Fog(mor_m=mor), 0), ["mde"])["mde"] for mor in (400.0, 30.0)]
        >>> scores[0] < scores[1]
        True
    """

    points: Tensor = field(kw_only=True)
    lidar: Lidar = field(kw_only=True)
    beams: Tensor | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    sensor: ClassVar[str] = "lidar"

    @property
    def clear(self) -> Tensor:
        """The cloud in clear air."""
        return self.points

    @property
    def label_shape(self) -> tuple[int, ...]:
        """Of a class for each point."""
        return (len(self.points),)

    def run(self, weather: Weather, seed: int, effects: Sequence[Mapping[str, Any]] = ()) -> LidarResult:
        """The cloud in a weather, with what each point is; ``effects`` come beside those of the options."""
        transform = LidarWeather(weather, self.lidar, **_with_effects(self.options, effects))
        with torch.no_grad():
            return transform.run(self.points, transform.draw(self.points, seed=seed), directions=self.beams)

    def render(self, weather: Weather, seed: int) -> Tensor:
        """The cloud in a weather; lost points are zero."""
        points = self.run(weather, seed).points
        assert isinstance(points, Tensor)
        return points


@dataclass(frozen=True, eq=False)
class RadarSubject(_Points):
    """A radar's list of detections; attenuation weakens them until some are lost.

    Args:
        name, scene, indoors, region: as in every cloud.
        points: ``(N, 6)`` x, y, z (m), speed (m/s), power (dB), cross section (dBsm).
        radar: the sensor.
        options: of ``RadarAttenuation``.
    """

    points: Tensor = field(kw_only=True)
    radar: Radar = field(kw_only=True)
    options: Mapping[str, Any] = field(default_factory=dict)

    sensor: ClassVar[str] = "radar"

    @property
    def clear(self) -> Tensor:
        """The detections in clear air."""
        return self.points

    def render(self, weather: Weather, seed: int) -> Tensor:
        """The detections in a weather; lost ones are zero."""
        transform = RadarAttenuation(weather, self.radar, **self.options)
        with torch.no_grad():
            found = transform(self.points, transform.draw(self.points, seed=seed))
        assert isinstance(found, Tensor)
        return found


@dataclass(frozen=True, eq=False)
class RadarSceneSubject(_Points):
    """A radar's frame, simulated from scatterers: beat signal, range-Doppler map, detections.

    Args:
        name, scene, indoors, region: as in every cloud.
        scatterers: what the radar sees, such as those of ``torchweather.scenes.radar_view``.
        radar: the sensor.
        noise_seed: of the receiver's noise.
        options: of ``FmcwRadar``.

    Note:
        The receiver's noise is the same with and without weather; a seed draws rain and snow alone. So the clear
        frame scores as itself, and a difference is the weather's.
    """

    scatterers: Scatterers = field(kw_only=True)
    radar: Radar = field(kw_only=True)
    noise_seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    _clear: Tensor = field(init=False, repr=False)

    sensor: ClassVar[str] = "radar"

    def __post_init__(self) -> None:
        check_arguments(
            "RadarSceneSubject(scatterers: Scatterers, radar: Radar, noise_seed: int, options: Mapping[str])",
            self.scatterers,
            self.radar,
            self.noise_seed,
            self.options,
        )
        super().__post_init__()
        check_options("RadarSceneSubject", FmcwRadar, self.options)
        object.__setattr__(self, "_clear", self._frame(None, {}))

    @property
    def clear(self) -> Tensor:
        """The detections in clear air."""
        return self._clear

    def render(self, weather: Weather, seed: int) -> Tensor:
        """The detections in a weather."""
        return self._frame(weather, FmcwRadar(self.radar, weather, **self.options).draw(self.scatterers, seed=seed))

    def _frame(self, weather: Weather | None, drawn: Mapping[str, Tensor]) -> Tensor:
        receiver = FmcwRadar(self.radar).draw(self.scatterers, seed=self.noise_seed)
        with torch.no_grad():
            found = FmcwRadar(self.radar, weather, **self.options)(self.scatterers, {**drawn, **receiver})
        assert isinstance(found, Tensor)  # one frame
        return found


def _with_effects(options: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Options of a transform with effects beside its own."""
    return {**options, "effects": [*options.get("effects", ()), *effects]} if effects else dict(options)
