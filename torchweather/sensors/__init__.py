"""Camera, Lidar, Radar: geometry, optics and link budget of a sensor, as frozen dataclasses with presets."""

from __future__ import annotations

from torchweather.errors import check_one_of
from torchweather.sensors.base import Sensor
from torchweather.sensors.camera import BAYER_PATTERNS, Camera
from torchweather.sensors.lidar import INTENSITY_UNITS, RETURN_MODES, Lidar
from torchweather.sensors.radar import Radar
from torchweather.sensors.scan import empty_beams, estimate_elevations, recover_ring, scan_directions

__all__ = [
    "BAYER_PATTERNS",
    "INTENSITY_UNITS",
    "RETURN_MODES",
    "Camera",
    "Lidar",
    "Radar",
    "Sensor",
    "empty_beams",
    "estimate_elevations",
    "recover_ring",
    "scan_directions",
    "sensor_preset",
]

SENSOR_CLASSES: dict[str, type[Camera] | type[Lidar] | type[Radar]] = {"camera": Camera, "lidar": Lidar, "radar": Radar}
DEFAULT_PRESETS = {"camera": "lucid-triton", "lidar": "ouster-os1-128", "radar": "imaging-77ghz"}


def sensor_preset(text: str) -> tuple[str, Camera | Lidar | Radar]:
    """Read ``kind`` or ``kind:preset`` as the command line takes it.

    Returns:
        The full name and the sensor.

    Example:
        >>> sensor_preset("lidar")[0]
        'lidar:ouster-os1-128'
    """
    kind, _, name = text.partition(":")
    check_one_of("sensor", kind, SENSOR_CLASSES, owner="torchweather")
    name = name or DEFAULT_PRESETS[kind]
    return f"{kind}:{name}", SENSOR_CLASSES[kind].preset(name)
