"""Camera, Lidar, Radar: geometry, optics and link budget of a sensor, as frozen dataclasses with presets."""

from __future__ import annotations

from torchweather.camera.frame_sizes import same_aspect
from torchweather.camera.sensor import BAYER_PATTERNS, Camera
from torchweather.camera.sensor_fit import CameraFit, fit_camera, without_distortion
from torchweather.core.arguments import check_arguments
from torchweather.core.errors import check_one_of
from torchweather.lidar.scan import empty_beams, estimate_elevations, recover_ring, scan_directions
from torchweather.lidar.sensor import INTENSITY_UNITS, RETURN_MODES, Lidar
from torchweather.pipeline.sensor import Sensor
from torchweather.radar.sensor import Radar

__all__ = [
    "BAYER_PATTERNS",
    "INTENSITY_UNITS",
    "RETURN_MODES",
    "Camera",
    "CameraFit",
    "Lidar",
    "Radar",
    "Sensor",
    "empty_beams",
    "estimate_elevations",
    "fit_camera",
    "recover_ring",
    "same_aspect",
    "scan_directions",
    "sensor_preset",
    "without_distortion",
]

SENSOR_CLASSES: dict[str, type[Camera] | type[Lidar] | type[Radar]] = {"camera": Camera, "lidar": Lidar, "radar": Radar}
DEFAULT_PRESETS = {"camera": "lucid-triton", "lidar": "ouster-os1-128", "radar": "imaging-77ghz"}


def sensor_preset(text: str) -> tuple[str, Camera | Lidar | Radar]:
    """Read ``kind``, ``kind:preset`` or ``kind:file.yaml`` as the command line takes it.

    Args:
        text: such as ``camera``, ``camera:kitti`` or ``lidar:my.yaml``, a file of the sensor's own fields (see
            `Sensor.preset`).

    Returns:
        The full name and the sensor.

    Raises:
        ValueError: an unknown kind or preset.
        TorchweatherError: a file that is missing, or a field in it that is wrong.

    Example:
        >>> sensor_preset("lidar")[0]
        'lidar:ouster-os1-128'
    """
    check_arguments("sensor_preset(text: str)", text)
    kind, _, name = text.partition(":")
    check_one_of("sensor", kind, SENSOR_CLASSES, owner="torchweather")
    name = name or DEFAULT_PRESETS[kind]
    return f"{kind}:{name}", SENSOR_CLASSES[kind].preset(name)
