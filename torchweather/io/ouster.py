"""Ouster recordings: organised clouds with the direction of every beam, from pcap and json, by Ouster's own SDK."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.errors import MissingExtraError, TorchweatherError, check_one_of
from torchweather.core.extras import install_hint
from torchweather.io.point_cloud import PointCloud

__all__ = ["OSF", "OSF_HINT", "OUSTER_INTENSITIES", "OusterFrame", "read_ouster"]

OSF = ".osf"
OSF_HINT = (
    "expected an Ouster recording as .pcap with its .json; got .osf. Convert it with ouster-cli of ouster-sdk: "
    "ouster-cli source FILE.osf save FILE.pcap, and pass --meta FILE_0.json."
)

OUSTER_INTENSITIES = ("reflectivity", "signal", "near_ir")
_COLUMNS = ("x", "y", "z", "intensity", "ring")
_PROBE_MM = 1000
# Packages whose name differs from the module's.
_PACKAGES = {"PIL": "pillow", "pkg_resources": "setuptools", "ruamel": "ruamel.yaml", "yaml": "pyyaml"}


@dataclass(frozen=True, eq=False)
class OusterFrame:
    """One turn of the sensor.

    Args:
        cloud: organised, rows of the grid are rings from top to bottom, columns go round; a beam without a return has
            range 0. x forward, y left, z up, in the frame of the sensor's housing.
        directions: ``(N, 3)`` float32 unit vector along each beam, also of those without a return; for
            ``Lidar(directions=...)``.
        origins_m: ``(N, 3)`` float32 where each beam starts. A return at range r is ``origin + r direction``: beams
            leave the turning mirror, not the origin of the frame. The offset is 3 to 8 cm, so the direction of a point
            as seen from the origin differs from its beam's by up to 0.5 degrees at 10 m, and in the limit not at all.
        frame_id: the sensor's count of frames.
        timestamp_ns: ``(W,)`` int64 time of each column, nanoseconds in the sensor's clock.
        product: of the sensor, such as ``OS-2-128``, as its metadata name it; empty where they do not.
    """

    cloud: PointCloud
    directions: Tensor
    origins_m: Tensor
    frame_id: int
    timestamp_ns: Tensor
    product: str = ""


def read_ouster(
    path: str | os.PathLike[str],
    meta: str | os.PathLike[str] | None = None,
    *,
    intensity: str = "reflectivity",
    incomplete: bool = True,
) -> Iterator[OusterFrame]:
    """The frames of a recording, one after another.

    Args:
        path: ``.pcap`` with the packets of one sensor.
        meta: the sensor's ``.json``; by default the file beside it of the same name.
        intensity: ``reflectivity`` (calibrated: 0..100 linear in percent, above that retroreflective; intensity unit
            ``uint8_calibrated``), ``signal`` (photons, not range corrected; not in low-bandwidth recordings), or
            ``near_ir`` (sunlight, for the curious).
        incomplete: give frames with missing columns too; those beams have range 0.

    Yields:
        Frames: x, y, z in metres, intensity, ring (0 at the top), float32. First returns only.

    Raises:
        ImportError: ``ouster-sdk`` (extra ``ouster``), or a package that it needs itself, is not installed.
        TorchweatherError: files are missing or broken, or the recording lacks the intensity.
    """
    check_one_of("intensity", intensity, OUSTER_INTENSITIES, owner="read_ouster")
    source = Path(path)
    if source.suffix.lower() == OSF:
        raise TorchweatherError(f"{source}: {OSF_HINT}")
    description = source.with_suffix(".json") if meta is None else Path(meta)
    for file in (source, description):
        if not file.is_file():
            raise TorchweatherError(
                f"{file}: no such file. read_ouster needs a pcap and the sensor's json (meta=..., on the command line "
                "--meta)."
            )
    try:
        sdk = importlib.import_module("ouster.sdk")  # untyped, and there only with the extra
    except ImportError as error:
        raise MissingExtraError(_what_to_install(error)) from error
    return _frames(sdk, source, description, intensity.upper(), incomplete)


def _what_to_install(error: ImportError) -> str:
    """Name the package that is missing: the SDK, or one that the SDK needs."""
    name = error.name or ""
    top = name.partition(".")[0]
    anew = "pip install --force-reinstall ouster-sdk"
    if isinstance(error, ModuleNotFoundError) and top not in ("", "ouster"):
        package = _PACKAGES.get(top, top)
        return (
            f"read_ouster needs {package!r}, which ouster-sdk needs ({error}). Install it with: pip install {package}, "
            f"or anew with {anew}"
        )
    if name in ("ouster", "ouster.sdk"):
        older = "" if name == "ouster" else "; the package installed as 'ouster' has no ouster.sdk"
        return f"read_ouster needs ouster-sdk 1.0 or newer{older}. {install_hint('ouster', '--upgrade')}"
    # An extension cannot be loaded: numpy or a library of the system is missing.
    return f"read_ouster: ouster-sdk is installed but cannot be loaded ({error}). Install it anew with: {anew}"


def _frames(sdk: Any, source: Path, description: Path, field: str, incomplete: bool) -> Iterator[OusterFrame]:
    try:
        recording = sdk.open_source(str(source), meta=[str(description)])
    except Exception as error:  # the SDK raises what its C++ parts raise
        raise TorchweatherError(f"{source}: cannot be opened with {description.name} ({error}).") from error
    found = 0
    try:
        infos = list(recording.sensor_info)
        if len(infos) != 1:
            raise TorchweatherError(f"{source}: expected the packets of one sensor; got {len(infos)}.")
        geometry = _Geometry(sdk.core, infos[0])
        frames = iter(recording)
        while True:
            try:
                scan = next(frames, None)
            except Exception as error:
                raise TorchweatherError(f"{source}: frame {found} cannot be read ({error}).") from error
            if scan is None:
                break
            frame = scan[0]
            if frame is None or not (incomplete or frame.complete()):
                continue
            found += 1
            yield geometry.frame(frame, field, source)
    finally:
        recording.close()
    if not found:
        raise TorchweatherError(f"{source}: expected LiDAR packets of the sensor in {description.name}; got no frame.")


class _Geometry:
    """Directions and origins of one sensor's beams, rows of the grid made straight."""

    def __init__(self, core: Any, info: Any) -> None:
        self._straight = core.destagger
        self._info = info
        table = core.XYZLut(info, use_extrinsics=False)
        height, width = int(info.format.pixels_per_column), int(info.format.columns_per_frame)
        # The table gives origin + range * direction; at range 0 it gives 0 (no return), so two ranges are needed.
        near, far = (np.asarray(table(np.full((height, width), k * _PROBE_MM, np.uint32)), np.float64) for k in (1, 2))
        per_metre = 1000.0 / _PROBE_MM
        directions = (far - near) * per_metre
        self._directions = self._rows(directions)  # (N, 3)
        self._origins = self._rows(near - directions / per_metre)
        self.grid = (height, width)
        self.ring = np.repeat(np.arange(height, dtype=np.float32), width)
        self.directions = torch.from_numpy(self._directions.astype(np.float32))
        self.origins_m = torch.from_numpy(self._origins.astype(np.float32))

    def _rows(self, staggered: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """``(H, W, ...)`` as measured to ``(H W, ...)`` with columns of one azimuth."""
        straight = np.asarray(self._straight(self._info, staggered))
        return np.ascontiguousarray(straight.reshape(-1, *straight.shape[2:]))

    def frame(self, frame: Any, field: str, source: Path) -> OusterFrame:
        names = [str(name) for name in frame.fields]
        if field not in names:
            raise TorchweatherError(
                f"{source}: expected intensity {field.lower()!r}; the recording has {', '.join(names).lower()}. "
                "Low-bandwidth recordings have no signal: take intensity='reflectivity'."
            )
        range_m = self._rows(np.asarray(frame.field("RANGE"))).astype(np.float64) / 1000.0
        hit = range_m > 0
        position = np.where(hit[:, None], self._origins + range_m[:, None] * self._directions, 0.0)
        strength = np.where(hit, self._rows(np.asarray(frame.field(field))), 0)
        table = np.concatenate((position, strength[:, None], self.ring[:, None]), axis=1).astype(np.float32)
        return OusterFrame(
            PointCloud(torch.from_numpy(table), _COLUMNS, self.grid),
            self.directions,
            self.origins_m,
            int(frame.frame_id),
            torch.from_numpy(np.asarray(frame.timestamp).astype(np.int64)),
            str(getattr(self._info, "prod_line", "") or ""),
        )
