"""A folder in the published layout of REHEARSE-3D, with recordings that the library simulates."""

from __future__ import annotations

from pathlib import Path

import torch

import torchweather as tw
from torchweather.image import demosaic, srgb_encode
from torchweather.io import write_image, write_points, write_table
from torchweather.lidar.effects.all import LidarWindowLoss
from torchweather.radar import FmcwRadar
from torchweather.scenes import Scene, cerema_tunnel, lidar_view, radar_view, thi_hall
from torchweather.scenes.raw_frame import raw_frame

__all__ = ["hall_of", "write_recordings"]

CLEAR = "000"


def hall_of(target: str, distance_m: float) -> Scene:
    """The hall in which a target stands at a distance: 15 m in the fog tunnel, 28 m and 56 m in the rain hall."""
    return cerema_tunnel(target, distance_m) if distance_m < 20.0 else thi_hall(target, distance_m)


def write_recordings(
    root: Path,
    scene: Scene,
    weathers: list[tw.Weather],
    lidar: tw.Lidar,
    camera: tw.Camera,
    *,
    frames: int,
    window_loss_db: float,
    seed: int = 0,
) -> dict[str, tw.Weather]:
    """Write a clear sequence and one for each weather.

    Args:
        root: folder to write; becomes ``REHEARSE3D_PUBLIC``.
        scene: what all sensors see.
        weathers: of the sequences ``001`` and so on.
        lidar, camera: with the resolution of the recordings.
        frames: of each sensor and sequence; the clear one has twice as many.
        window_loss_db: of the LiDAR in the weather, which the records do not tell.
        seed: of all noise and weather.

    Returns:
        Weather of each sequence but the clear one, by name.
    """
    recorded: dict[str, tw.Weather] = {f"{k:03d}": weather for k, weather in enumerate(weathers, start=1)}
    shots = iter(range(seed * 10_000, (seed + 1) * 10_000))
    radar = FmcwRadar(tw.Radar.preset("awr1843-like"))
    for name, weather in {CLEAR: None, **recorded}.items():
        for k in range(2 * frames if weather is None else frames):
            shot, stem = next(shots), f"{k:06d}"
            folder = root / "sequences" / name
            for sensor in ("arena", "ouster", "ext_radar"):
                (folder / sensor).mkdir(parents=True, exist_ok=True)
            write_image(folder / "arena" / f"{stem}.jpeg", _picture(scene, camera, weather, shot))
            write_points(folder / "ouster" / f"{stem}.bin", _cloud(scene, lidar, weather, window_loss_db, shot))
            write_table(folder / "ext_radar" / f"{stem}.csv", _detections(scene, radar, weather, shot))
    return recorded


def _picture(scene: Scene, camera: tw.Camera, weather: tw.Weather | None, seed: int) -> torch.Tensor:
    frame = raw_frame(scene, camera, seed=seed)
    raw = frame.bayer
    if weather is not None:
        kept = tw.BayerWeather(weather, frame.camera, airlight=frame.airlight, exposure_control="mean")
        raw = kept(raw, frame.depth_m, seed=seed)
    light = raw.float() / frame.camera.white_level
    colour = demosaic(light, frame.camera.bayer_pattern)
    return (255 * srgb_encode(colour).clamp(0, 1)).round().to(torch.uint8)


def _cloud(scene: Scene, lidar: tw.Lidar, weather: tw.Weather | None, window_loss_db: float, seed: int) -> torch.Tensor:
    view = lidar_view(scene, lidar, range_noise_seed=seed)
    points = view.points[:, :4]
    if weather is not None:
        wet = [LidarWindowLoss(loss_db=window_loss_db)]
        points = tw.LidarWeather(weather, lidar, effects=wet)(points, directions=view.directions, seed=seed)
    assert isinstance(points, torch.Tensor)
    return points[(points[:, :3] != 0).any(-1)]


def _detections(scene: Scene, clear: FmcwRadar, weather: tw.Weather | None, seed: int) -> dict[str, list[float]]:
    radar = clear if weather is None else FmcwRadar(clear.list_sensor, weather)
    scatterers = radar_view(scene, clear.list_sensor).scatterers
    points = radar(scatterers, radar.draw(scatterers, seed=seed))
    assert isinstance(points, torch.Tensor)
    names = ("x", "y", "z", "velocity", "intensity", "cross section")
    return {name: points[:, k].tolist() for k, name in enumerate(names)}
