"""Put rain on what CARLA's sensors send, camera, LiDAR and radar in one storm, with the time that each frame takes.

    python examples/carla_in_weather.py                       # without CARLA: buffers made from the embedded scene
    python examples/carla_in_weather.py --host localhost      # a running simulator; needs the package carla

A `CarlaRig` listens to the sensors, gathers the buffers of one frame, puts them through one `Compose` and hands the
sample on. Without a simulator the same listeners are called with buffers in the layout of CARLA's sensor reference. The
picture shows the last frame before and after.

In the simulator the world's own weather is switched off, with the LiDAR's attenuation and drop-off; the vehicle drives
by the autopilot. That part is tested against no simulator.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
from parts.carla_sources import made_buffers, simulator
from parts.shared import command_line, write_figure

import torchweather as tw
from torchweather.datasets import CarlaRig, camera_from_carla, detections_to_carla, points_to_carla

parser = command_line(__doc__)
parser.add_argument("--rate", type=float, default=50.0, help="rain, mm/h")
parser.add_argument("--seed", type=int, default=7)
parser.add_argument("--frames", type=int, default=5)
parser.add_argument("--width", type=int, default=640, help="of the camera's frame, pixels; the height is half of it")
parser.add_argument("--host", help="of a CARLA server; without it, made buffers")
parser.add_argument("--port", type=int, default=2000)
parser.add_argument("--out", type=Path, default=Path("carla_in_weather.png"), help="picture to write")
arguments = parser.parse_args()

sizes = SimpleNamespace(width=arguments.width // 4 * 4, height=arguments.width // 4 * 2, fov=90.0)

camera = camera_from_carla(sizes, exposure_s=1 / 200)  # CARLA's default shutter
lidar = tw.Lidar(
    wavelength_nm=905.0,
    elevations_deg=tuple(10.0 - 40.0 * k / 31 for k in range(32)),  # CARLA's default: 32 lasers, +10 to -30 degrees
    columns=720,
    max_range_m=100.0,
    intensity_unit="none",  # CARLA's intensity says nothing of the target
)
radar = tw.Radar.preset("imaging-77ghz")
rain = tw.Rain(rate_mm_per_h=arguments.rate)
storm = tw.Compose(
    {
        "image": tw.AsBayer(tw.BayerRain(rain, camera, far_m=80)),
        "points": tw.LidarRain(rain, lidar, complete_scan=True),
        "radar": tw.RadarAttenuation(rain, radar),
    },
    seed=arguments.seed,
    sample_key="frame",  # frame 12 has the same drops in every run
)
before: dict[str, Any] = {}
after: dict[str, Any] = {}


def weather(sample: dict[str, Any]) -> dict[str, Any]:
    before.update(sample)
    return storm(sample)


rig = CarlaRig(
    weather,
    {"image": "camera", "depth": "depth", "points": "lidar", "radar": "radar"},
    deliver=after.update,
    radar=radar,
    report=print,
)

listeners = {key: rig.listener(key) for key in rig.sensors}
if arguments.host:
    try:
        import carla
    except ImportError:
        parser.error("--host needs the package carla, of the simulator's version: pip install carla")
    simulator(carla, listeners, rig, lidar, sizes, (arguments.host, arguments.port), arguments.frames)
else:
    made_buffers(listeners, camera, lidar, radar, sizes, arguments.frames)

if not rig.times_s:
    parser.error("no frame became complete: not all sensors sent one")
times_ms = [1e3 * seconds for seconds in rig.times_s]
print(f"{len(times_ms)} frames: {times_ms[0]:.0f} ms the first, {min(times_ms):.0f} ms the fastest")
back = points_to_carla(after["points"])
print(f"LiDAR: {len(before['points'])} returns in clear air, {len(back)} in the rain, as CARLA's float32 {back.shape}")
print(f"radar: {len(before['radar'])} detections in clear air, {len(detections_to_carla(after['radar']))} in the rain")

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  # after the backend is chosen

figure, axes = plt.subplots(2, 2, figsize=(12, 8), layout="constrained")
for column, (name, sample) in enumerate((("clear", before), (f"rain of {arguments.rate:g} mm/h", after))):
    axes[0, column].imshow(sample["image"].permute(1, 2, 0).numpy())
    axes[0, column].set(title=name, xticks=[], yticks=[])
    points, found = (rows[(rows[:, :3] != 0).any(1)] for rows in (sample["points"], sample["radar"]))  # lost: 0
    axes[1, column].scatter(points[:, 0], points[:, 1], s=0.3, c="0.4", label="LiDAR")
    axes[1, column].scatter(found[:, 0], found[:, 1], s=6, c="C3", label="radar")
    axes[1, column].set(
        xlabel="x, forward, in m", ylabel="y, left, in m", xlim=(-20, 80), ylim=(-30, 30), aspect="equal"
    )
    axes[1, column].legend(loc="upper right", fontsize=8, markerscale=4)
write_figure(arguments.out, figure, dpi=110)
print(f"picture: {arguments.out}")
