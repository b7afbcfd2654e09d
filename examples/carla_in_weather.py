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

import argparse
import contextlib
import queue
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
import torch

import torchweather as tw
from torchweather.image import develop
from torchweather.io import (
    CarlaRig,
    atomic_write,
    camera_from_carla,
    depth_to_carla,
    detections_to_carla,
    image_to_carla,
    points_to_carla,
)
from torchweather.scenes import lidar_view, radar_view, test_track

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--rate", type=float, default=50.0, help="rain, mm/h")
parser.add_argument("--seed", type=int, default=7)
parser.add_argument("--frames", type=int, default=5)
parser.add_argument("--width", type=int, default=640, help="of the camera's frame, pixels; the height is half of it")
parser.add_argument("--host", help="of a CARLA server; without it, made buffers")
parser.add_argument("--port", type=int, default=2000)
parser.add_argument("--out", type=Path, default=Path("carla_in_weather.png"), help="picture to write")
arguments = parser.parse_args()

width, height, fov_deg = arguments.width // 4 * 4, arguments.width // 4 * 2, 90.0
elevations_deg = tuple(10.0 - 40.0 * k / 31 for k in range(32))  # CARLA's default: 32 lasers from +10 to -30 degrees
columns, range_m = 720, 100.0
sizes = SimpleNamespace(width=width, height=height, fov=fov_deg)

camera = camera_from_carla(sizes, exposure_s=1 / 200)  # CARLA's default shutter
lidar = tw.Lidar(
    wavelength_nm=905.0,
    elevations_deg=elevations_deg,
    columns=columns,
    max_range_m=range_m,
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


def made_buffers(listen: dict[str, Callable[[Any], None]]) -> None:
    """The embedded scene as CARLA would send it, frame after frame."""
    scene = test_track()
    view = scene.view(camera)
    rgb = (develop(view.bayer, camera.bayer_pattern, exposure=1.3) * 255).round().to(torch.uint8)
    cloud = lidar_view(scene, lidar).points[:, :4]
    cloud[:, 3] = torch.exp(-0.004 * torch.linalg.vector_norm(cloud[:, :3], dim=1))  # CARLA's default attenuation
    echoes = radar_view(scene, radar, ego_speed_m_per_s=8.0).scatterers
    nothing = torch.zeros(len(echoes.position_m), 2)
    detections = torch.cat([echoes.position_m, echoes.speed_m_per_s[:, None], nothing], 1)
    raw = {
        "image": image_to_carla(rgb).tobytes(),
        "depth": depth_to_carla(view.depth_m).tobytes(),
        "points": points_to_carla(cloud).tobytes(),
        "radar": detections_to_carla(detections).tobytes(),
    }
    for frame in range(1, arguments.frames + 1):
        for key, buffer in raw.items():
            listen[key](SimpleNamespace(raw_data=buffer, frame=frame, timestamp=0.05 * frame, **vars(sizes)))


def simulator(listen: dict[str, Callable[[Any], None]]) -> None:
    """A vehicle with four sensors in a running CARLA, in synchronous mode."""
    try:
        import carla
    except ImportError:
        parser.error("--host needs the package carla, of the simulator's version: pip install carla")
    client = carla.Client(arguments.host, arguments.port)
    client.set_timeout(20.0)
    world = client.get_world()
    own_weather = world.get_weather()
    world.set_weather(carla.WeatherParameters.ClearNoon)
    settings = world.get_settings()
    asynchronous = world.get_settings()
    settings.synchronous_mode, settings.fixed_delta_seconds = True, 0.05
    world.apply_settings(settings)
    traffic = client.get_trafficmanager()
    traffic.set_synchronous_mode(True)
    library, actors, arrived = world.get_blueprint_library(), [], queue.Queue()
    rig.deliver = lambda sample: (after.update(sample), arrived.put(sample["frame"]))
    frame = {"image_size_x": width, "image_size_y": height, "fov": fov_deg}
    blueprints: dict[str, tuple[str, dict[str, Any]]] = {
        "image": ("sensor.camera.rgb", {**frame, "enable_postprocess_effects": False, "lens_k": 0, "lens_kcube": 0}),
        "depth": ("sensor.camera.depth", {**frame, "lens_k": 0, "lens_kcube": 0}),
        "points": (
            "sensor.lidar.ray_cast",
            {
                "channels": len(elevations_deg),
                "upper_fov": elevations_deg[0],
                "lower_fov": elevations_deg[-1],
                "range": range_m,
                "rotation_frequency": 20,
                "points_per_second": 20 * columns * len(elevations_deg),
                "atmosphere_attenuation_rate": 0,
                "dropoff_general_rate": 0,
                "dropoff_zero_intensity": 0,
            },
        ),
        "radar": ("sensor.other.radar", {"horizontal_fov": 90, "vertical_fov": 20, "range": range_m}),
    }
    try:
        place = world.get_map().get_spawn_points()[0]
        car = world.spawn_actor(library.filter("vehicle.*")[0], place)
        actors.append(car)
        car.set_autopilot(True, traffic.get_port())
        for key, (name, attributes) in blueprints.items():
            blueprint = library.find(name)
            for attribute, value in attributes.items():
                blueprint.set_attribute(attribute, str(value))
            height_m = 0.5 if key == "radar" else 1.7
            mount = carla.Transform(carla.Location(x=2.5 if key == "radar" else 0.0, z=height_m))
            actors.append(world.spawn_actor(blueprint, mount, attach_to=car))
            actors[-1].listen(listen[key])
        for _ in range(arguments.frames):
            number = world.tick()
            # A sensor may miss the first ticks after it was placed.
            with contextlib.suppress(queue.Empty):
                while arrived.get(timeout=10.0) < number:
                    pass
    finally:
        for actor in reversed(actors):
            actor.destroy()
        traffic.set_synchronous_mode(False)
        world.set_weather(own_weather)
        world.apply_settings(asynchronous)


listeners = {key: rig.listener(key) for key in rig.sensors}
(simulator if arguments.host else made_buffers)(listeners)

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
with atomic_write(arguments.out) as unfinished:
    figure.savefig(unfinished, dpi=110)
plt.close(figure)
print(f"picture: {arguments.out}")
