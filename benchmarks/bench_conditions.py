"""Times of water and snow on things: what each condition adds to a frame of a camera, LiDAR and radar.

    python benchmarks/bench_conditions.py --out benchmarks/conditions.json
    python benchmarks/bench_conditions.py --quick                        # tries the script, the figures mean nothing

The embedded test track: a raw frame of the Lucid Triton at half its size (960 x 720), a sweep of an Ouster OS1-128, and
a list of 256 detections. Times are of a call with given noise, beside that of clear air (rain of 0 mm/h), which is the
first row.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import torch
from measure import hand_over, machine, times_ms

import torchweather as tw
from torchweather.atmosphere.weather import Weather
from torchweather.scenes import lidar_view, test_track

CLEAR = tw.Rain(0.0)
WEATHERS: dict[str, Weather] = {
    "clear": CLEAR,
    "wet-road": tw.Mixture(CLEAR, tw.WetRoad(water_mm=1.0)),
    "wet-road, puddles": tw.Mixture(CLEAR, tw.WetRoad(water_mm=1.0, puddles=0.5)),
    "wet-window": tw.Mixture(CLEAR, tw.WetWindow(speed_m_per_s=20.0, rain_mm_per_h=25.0, wiper_s=4.0)),
    "snow-cover": tw.Mixture(CLEAR, tw.SnowCover(depth_mm=20.0)),
    "road-spray": tw.Mixture(CLEAR, tw.RoadSpray(speed_m_per_s=25.0, distance_m=20.0, water_mm=2.0)),
}


def main() -> None:
    """Read the command line, measure, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    repeats = 1 if arguments.quick else 7
    width = 96 if arguments.quick else 960
    camera = tw.Camera.preset("lucid-triton").resized(width, width * 3 // 4)
    view = test_track().view(camera)
    lidar = tw.Lidar.preset("ouster-os1-128", **({"columns": 64} if arguments.quick else {}))
    points = lidar_view(test_track(), lidar).points[:, :4]
    radar = tw.Radar.preset("imaging-77ghz")
    targets = torch.zeros(256, 6)
    targets[:, 0], targets[:, 4] = torch.linspace(2.0, 100.0, 256), -80.0
    figures: dict[str, Any] = {
        "what": f"camera {camera.width} x {camera.height}, LiDAR of {len(points)} beams, radar list of 256",
        "quick": arguments.quick,
        "machine": machine(),
        "camera": {},
        "lidar": {},
        "radar": {},
    }
    with torch.no_grad():
        for name, weather in WEATHERS.items():
            seen = tw.BayerWeather(weather, camera, airlight=0.7)
            swept = tw.LidarWeather(weather, lidar)
            listed = tw.RadarAttenuation(weather, radar)
            noise = [one.draw(data, seed=1) for one, data in ((seen, view.bayer), (swept, points), (listed, targets))]
            calls = {
                "camera": lambda: seen(view.bayer, view.depth_m, noise[0]),  # noqa: B023
                "lidar": lambda: swept(points, noise[1]),  # noqa: B023
                "radar": lambda: listed(targets, noise[2]),  # noqa: B023
            }
            for sensor, call in calls.items():
                figures[sensor][name] = times_ms(call, repeats)
    hand_over(figures, arguments.out)


if __name__ == "__main__":
    main()
