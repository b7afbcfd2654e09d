"""Times of a camera's options (multiple scattering, lamps at night, exposure control) and of further kinds of sensors.

    python benchmarks/bench_camera_options.py --out benchmarks/camera_options.json
    python benchmarks/bench_camera_options.py --quick                    # tries the script, the figures mean nothing

The embedded test track, a raw frame of the Lucid Triton at half its size (960 x 720), by night a tenth as bright. Times
are of a call with given noise, beside the same weather without the option. Beside them: a camera of two exposures, a
thermal camera of the same size, a Doppler (FMCW) and a flash LiDAR.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path
from typing import Any

import torch
from measure import hand_over, machine, times_ms

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.scenes import lidar_view, test_track
from torchweather.transforms import HdrWeather, ThermalWeather

WEATHERS: dict[str, Weather] = {"fog": tw.Fog(50.0), "rain": tw.Rain(25.0), "snow": tw.Snow(2.0)}
LAMPS = tuple(tw.Lamp((forward, 4.0, 7.0), 2000.0) for forward in (30.0, 60.0, 90.0))
OPTIONS: dict[str, dict[str, Any]] = {
    "none": {},
    "scattering=multiple": {"scattering": "multiple"},
    "night, own headlamps": {"night": tw.Night(lamps=())},
    "night, three lamps more": {"night": tw.Night(lamps=LAMPS)},
    "exposure_control=mean": {"exposure_control": "mean"},
}
OF_FOG = "scattering=multiple"
LIDARS = {"Doppler LiDAR": "aeva-aevascenes-wide", "flash LiDAR": "generic-flash-1064nm"}
POINTS = 65_536  # of the Doppler LiDAR, whose preset has no scan pattern


def sensor_times(weather: Weather, camera: tw.Camera, view: Any, repeats: int) -> dict[str, Any]:
    """Times of a camera of two exposures, a thermal camera and two LiDARs in a weather."""
    found = {}
    hdr = HdrWeather(weather, camera, exposures_s=(0.016, 0.001), airlight=0.7)
    noise = hdr.draw(view.bayer, seed=1)
    found["HDR of two exposures"] = times_ms(lambda: hdr(view.bayer, view.depth_m, noise), repeats)
    thermal, warm = ThermalWeather(weather, camera), torch.full(view.bayer.shape, 12.0)
    found["thermal, 8 to 14 um"] = times_ms(lambda: thermal(warm, view.depth_m), repeats)
    for name, preset in LIDARS.items():
        lidar = tw.Lidar.preset(preset)
        even = torch.rand(POINTS, 5, generator=torch.Generator().manual_seed(1))
        cloud = even * torch.tensor([80.0, 40.0, 4.0, 0.0, 0.0]) + torch.tensor([3.0, -20.0, -1.8, 0.2, 0.0])
        if lidar.speed_column is None:
            cloud = lidar_view(test_track(), lidar).points[:, :4]
        swept = tw.LidarWeather(weather, lidar)
        drawn = swept.draw(cloud, seed=1)
        found[f"{name} of {len(cloud)} points"] = times_ms(lambda: swept(cloud, drawn), repeats)  # noqa: B023
    return found


def main() -> None:
    """Read the command line, measure, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    width = 96 if arguments.quick else 960
    camera = tw.Camera.preset("lucid-triton").resized(width, width * 3 // 4)
    view = test_track().view(camera)
    figures: dict[str, Any] = {
        "what": f"camera {camera.width} x {camera.height}",
        "quick": arguments.quick,
        "machine": machine(),
        "times": {},
    }
    repeats = 1 if arguments.quick else 7
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a day frame made dark
        for kind, weather in WEATHERS.items():
            for name, options in OPTIONS.items():
                if name == OF_FOG and kind != "fog":
                    continue
                transform = tw.BayerWeather(weather, camera, airlight=0.7, **options)
                frame = view.bayer * (0.1 if "night" in options else 1.0)
                noise = transform.draw(frame, seed=1)
                call = lambda: transform(frame, view.depth_m, noise)  # noqa: B023, E731
                figures["times"].setdefault(kind, {})[name] = times_ms(call, repeats)
            found = sensor_times(weather, camera, view, repeats)
            figures["times"][kind] |= found
    hand_over(figures, arguments.out)


if __name__ == "__main__":
    main()
