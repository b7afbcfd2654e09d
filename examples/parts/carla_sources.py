"""What CARLA's sensors send: buffers made of the embedded scene, or those of a running simulator."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import torch

import torchweather as tw
from torchweather.datasets import CarlaRig, depth_to_carla, detections_to_carla, image_to_carla, points_to_carla
from torchweather.image import develop
from torchweather.scenes import lidar_view, radar_view, test_track

Listeners = dict[str, Callable[[Any], None]]


def made_buffers(
    listen: Listeners, camera: tw.Camera, lidar: tw.Lidar, radar: tw.Radar, sizes: SimpleNamespace, frames: int
) -> None:
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
    for frame in range(1, frames + 1):
        for key, buffer in raw.items():
            listen[key](SimpleNamespace(raw_data=buffer, frame=frame, timestamp=0.05 * frame, **vars(sizes)))


def simulator(
    carla: Any,
    listen: Listeners,
    rig: CarlaRig,
    lidar: tw.Lidar,
    sizes: SimpleNamespace,
    server: tuple[str, int],
    frames: int,
) -> None:
    """A vehicle with four sensors in a running CARLA, in synchronous mode.

    Args:
        carla: the package, of the simulator's version.
        listen: what each sensor calls.
        rig: of these listeners; its delivery is waited for.
        lidar: whose scan the simulated one has.
        sizes: of the camera's frame.
        server: host and port.
        frames: how many.
    """
    client = carla.Client(*server)
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
    deliver = rig.deliver
    rig.deliver = lambda sample: (deliver(sample), arrived.put(sample["frame"]))
    frame = {"image_size_x": sizes.width, "image_size_y": sizes.height, "fov": sizes.fov}
    elevations_deg, columns, range_m = lidar.elevations_deg, lidar.columns, lidar.max_range_m
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
        for _ in range(frames):
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
