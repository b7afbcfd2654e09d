"""Sweeps that do not fit their sensor: each is refused with its cause, or completed where that can be done.

The same rows on a made sweep and on one of KITTI (000008, HDL-64E; skipped where it is not there).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.lidar.sweep.scan_sweep import COLUMNS, ELEVATIONS_DEG, HEIGHTS_M, sweep
from tests.recordings import recording
from torchweather.atmosphere.weather import Snow
from torchweather.cli import main
from torchweather.datasets import read_kitti_points
from torchweather.lidar import estimate_pattern
from torchweather.lidar.sweep.completion import complete_scan
from torchweather.sensors import Lidar
from torchweather.stages import PointKind
from torchweather.transforms import LidarSnow

TILTED = ((0.9962, 0.0, 0.0872), (0.0, 1.0, 0.0), (-0.0872, 0.0, 0.9962))  # nose down by 5 degrees


@dataclass(frozen=True)
class Sweep:
    """Cloud ``(N, 4)`` whose rows are ring after ring, its sensor, the ring of each row and the missing beams."""

    cloud: Tensor
    sensor: Lidar
    ring: Tensor
    missing: int


def made() -> Sweep:
    points, ring = sweep()
    points[:, 3] = 0.8  # the sweep's road and walls are seen at every range
    sensor = Lidar(
        905.0,
        elevations_deg=tuple(ELEVATIONS_DEG.tolist()),
        origin_heights_m=tuple(HEIGHTS_M.tolist()),
        columns=COLUMNS,
        max_range_m=100.0,
        intensity_unit="reflectivity",
    )
    return Sweep(torch.from_numpy(points), sensor, torch.from_numpy(ring), 24 * COLUMNS - len(points))


def kitti() -> Sweep:
    cloud = read_kitti_points(recording("kitti_13/velodyne/000008.bin"))
    sensor = Lidar.preset("velodyne-hdl-64e", intensity_unit="reflectivity")
    ring = torch.from_numpy(estimate_pattern(cloud[:, :3]).ring)
    return Sweep(cloud, sensor, ring, 15_524)  # 64 rings x 2157 columns less 122,555 returns, within 0.3 %


@pytest.fixture(scope="module", params=["made", pytest.param("kitti", marks=pytest.mark.real_data)])
def given(request: pytest.FixtureRequest) -> Sweep:
    return made() if request.param == "made" else kitti()


def moved(cloud: Tensor, metres: tuple[float, float, float]) -> Tensor:
    return torch.cat([cloud[:, :3] + torch.tensor(metres), cloud[:, 3:]], 1)


def turned(cloud: Tensor, pitch_deg: float = 0.0, yaw_deg: float = 0.0) -> Tensor:
    p, y = np.radians([pitch_deg, yaw_deg])
    pitch = torch.tensor([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
    yaw = torch.tensor([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
    return torch.cat([(cloud[:, :3].double() @ (yaw @ pitch).T).float(), cloud[:, 3:]], 1)


def shuffled(cloud: Tensor) -> Tensor:
    return cloud[torch.randperm(len(cloud), generator=torch.Generator().manual_seed(0))]


def azimuth_deg(xyz: Tensor) -> Tensor:
    return torch.rad2deg(torch.atan2(xyz[:, 1], xyz[:, 0]))


def compensated(cloud: Tensor, metres_a_turn: float, moment: float = 0.5) -> Tensor:
    """The cloud as it is seen from where the sensor was at a moment of the turn."""
    out = cloud.clone()
    out[:, 0] += (azimuth_deg(cloud) % 360.0 / 360.0 - moment) * metres_a_turn
    return out


def with_nan(cloud: Tensor) -> Tensor:
    out = cloud.clone()
    out[::1000, :3] = torch.nan
    return out


def second_echoes(given: Sweep, every: int) -> Tensor:
    """The cloud with a second, nearer echo behind each ``every``-th row, in the rows that follow."""
    rows = torch.arange(len(given.cloud))
    picked = rows[::every]
    heights = torch.tensor(given.sensor.origin_heights_m)
    numbers = torch.argsort(torch.argsort(_elevations(given)))  # of the sweep's rings in the sensor's order
    start = torch.zeros(len(picked), 3)
    start[:, 2] = heights[torch.argsort(torch.tensor(given.sensor.elevations_deg))][numbers[given.ring[picked]]]
    nearer = given.cloud[picked].clone()
    nearer[:, :3] = start + 0.8 * (nearer[:, :3] - start)
    return torch.cat([given.cloud, nearer])[torch.cat([rows, picked]).argsort(stable=True)]


def _elevations(given: Sweep) -> Tensor:
    rings = int(given.ring.max()) + 1
    value = torch.atan2(given.cloud[:, 2], given.cloud[:, :2].norm(dim=1))
    sums = torch.zeros(rings).index_add_(0, given.ring, value)
    return sums / torch.bincount(given.ring, minlength=rings)


def of_other_sensor(sensor: Lidar) -> Lidar:
    """As many rings, over a view 1.6 times as wide."""
    wider = tuple(1.6 * e + 10.0 for e in sensor.elevations_deg or ())
    return replace(sensor, elevations_deg=wider)


def of_16_rings(sensor: Lidar) -> Lidar:
    return replace(
        sensor, elevations_deg=tuple(range(-15, 16, 2)), origin_heights_m=None, azimuth_offsets_deg=None, columns=1800
    )


def with_ring(given: Sweep, scale: float) -> Tensor:
    return torch.cat([given.cloud, scale * given.ring[:, None].float()], 1)


Change = Callable[[Sweep], tuple[Tensor, Lidar]]

# What comes, what is done to the sweep, and what the error must say: what was expected, what came, what to do.
REFUSED: dict[str, tuple[Change, str]] = {
    "map's frame": (
        lambda s: (moved(s.cloud, (300.0, 120.0, 5.0)), s.sensor),
        (
            r"meet in \(300\.00, 120\.00, 5\.\d\d\) m, .*not in the cloud's origin.*Pass Lidar\(origin_m=\(300\.00, .*"
            "on the command line --sensor-origin 300"
        ),
    ),
    "map's axes": (
        lambda s: (moved(turned(s.cloud, yaw_deg=37.0), (300.0, 120.0, 5.0)), s.sensor),
        r"meet in \(300\.00, 120\.00, 5\.\d\d\) m, .*--sensor-origin 300\.00 120\.00",
    ),
    "above the ground of a map": (
        lambda s: (moved(s.cloud, (0.0, 0.0, 5.0)), s.sensor),
        r"beams start 5\.\d\d m above the origin of the cloud.*Pass Lidar\(origin_m=\(0, 0, 5\.\d\d\)\)",
    ),
    "vehicle's frame": (
        lambda s: (moved(s.cloud, (1.43, 0.0, 2.18)), s.sensor),
        r"meet in \(1\.4\d, -?0\.0\d, 2\.\d\d\) m.*--sensor-origin 1\.4",
    ),
    "tilted by 5 degrees": (
        lambda s: (turned(s.cloud, pitch_deg=5.0), s.sensor),
        r"tilted against its sensor, whose plane rises -(5\.0|4\.9)\d degrees .*Pass Lidar\(rotation=\(\(0\.996",
    ),
    "tilted by 1 degree": (
        lambda s: (turned(s.cloud, pitch_deg=1.0), s.sensor),
        r"tilted against its sensor, whose plane rises -(1\.0|0\.9)\d degrees along x .*--sensor-pose",
    ),
    "tilted, in no order": (
        lambda s: (turned(shuffled(s.cloud), pitch_deg=5.0), s.sensor),
        r"expected the rings of a LiDAR.*Is the cloud tilted, in a map's frame, .*Pass one sweep as",
    ),
    "camera's axes": (
        lambda s: (torch.stack([-s.cloud[:, 1], -s.cloud[:, 2], s.cloud[:, 0], s.cloud[:, 3]], 1), s.sensor),
        r"expected the rings of a LiDAR.*Is the cloud tilted",
    ),
    "millimetres": (
        lambda s: (torch.cat([1000.0 * s.cloud[:, :3], s.cloud[:, 3:]], 1), s.sensor),
        r"expected metres in the sensor's frame; got points at \d+ m in the median.*divide by 1000",
    ),
    "a quarter of the rings": (
        lambda s: (s.cloud[s.ring % 4 == 0], s.sensor),
        r"The sensor has (24|64) rings from .*; the sweep shows (6|16) rings .*torchweather fit-sensor",
    ),
    "declared as 16 rings": (
        lambda s: (s.cloud, of_16_rings(s.sensor)),
        r"The sensor has 16 rings from -15\.0 to 15\.0 degrees; the sweep shows (24|64) rings from .*another sensor",
    ),
    "declared as 16 rings, in no order": (
        lambda s: (shuffled(s.cloud), of_16_rings(s.sensor)),
        r"The sensor has 16 rings from -15\.0 to 15\.0 degrees; the sweep shows (24|64) rings from .*another sensor",
    ),
    "another sensor of as many rings": (
        lambda s: (s.cloud, of_other_sensor(s.sensor)),
        r"the sweep shows (24|64) rings from .* degrees beside them in the median: another sensor",
    ),
    "rings beyond the sensor's": (
        lambda s: (with_ring(s, 1.0), replace(of_16_rings(s.sensor), ring_column=4)),
        (
            r"expected ring numbers 0 to 15 of the sensor's 16 rings in column 4; got .* (23|63)\..*torchweather "
            "list"
        ),
    ),
    "a place beside the sensor": (
        lambda s: (moved(s.cloud, (1.0, 0.0, 0.0)), s.sensor),
        r"meet in \(1\.0\d, -?0\.0\d, 0\.\d\d\) m.*--sensor-origin 1\.0",
    ),
    "another column as the ring": (
        lambda s: (with_ring(s, 0.37), replace(s.sensor, ring_column=4)),
        r"expected whole ring numbers in column 4; got fractions.*Lidar\(ring_column=\.\.\.\)",
    ),
    "every second column": (
        lambda s: (s.cloud[::2], s.sensor),
        (
            r"expected neighbours 0\.\d+ degrees apart .*, as Lidar\(columns=\d+\) has them; the sweep's are 0\.\d+ "
            r"degrees apart\. Pass the sweep before it was thinned, or Lidar\(columns=\d+\)"
        ),
    ),
    "written twice": (
        lambda s: (torch.cat([s.cloud, s.cloud]), s.sensor),
        r"expected every return once; (49|50|51) % of the rows repeat others elsewhere in the file.*Drop the copies",
    ),
    "compensated for fast motion": (
        lambda s: (compensated(s.cloud, 3.0), s.sensor),
        r"expected the rings of a LiDAR .*compensated for fast motion.*Pass one sweep as its sensor gave it",
    ),
    "rows of NaN": (
        lambda s: (with_nan(s.cloud), s.sensor),
        (
            r"got (NaN or infinity in )?(20|123) .*rows.*Give a beam without return the coordinates 0, "
            "0, 0"
        ),
    ),
}


EVERY_TIME = ("map's frame", "millimetres", "every second column", "rows of NaN")  # of KITTI, beside all made ones


def _each_refused() -> list[Any]:
    costly = [("kitti", name) for name in REFUSED if name not in EVERY_TIME]
    cases = [(source, name) for source in ("made", "kitti") for name in REFUSED]
    marks = {"kitti": [pytest.mark.real_data], "made": []}
    return [
        pytest.param(*case, marks=[*marks[case[0]], *([pytest.mark.long] if case in costly else [])]) for case in cases
    ]


@pytest.mark.parametrize(("given", "name"), _each_refused(), indirect=["given"])
def test_an_unfit_sweep_is_refused_with_the_cause(given: Sweep, name: str) -> None:
    change, sentence = REFUSED[name]
    cloud, sensor = change(given)
    snow = LidarSnow(Snow(rate_mm_per_h=1.0), sensor, complete_scan=True)
    with pytest.raises(ValueError, match=sentence) as raised:
        snow.draw(cloud, seed=1)
    assert "\n" not in str(raised.value)


# What is completed: what is done to the sweep, what the words must say, and how far the beams appended may be from
# those of the whole (a bend of the cones by motion is followed to first order).
COMPLETED: dict[str, tuple[Change, str, float]] = {
    "as it is": (lambda s: (s.cloud, s.sensor), r"rings from the order of the rows\)$", 0.01),
    "rows in no order": (lambda s: (shuffled(s.cloud), s.sensor), r"rings from the elevations\)$", 0.01),
    "turned about the vertical": (lambda s: (turned(s.cloud, yaw_deg=37.0), s.sensor), r"order of the rows\)$", 0.01),
    "tilt given": (
        lambda s: (turned(s.cloud, pitch_deg=5.0), replace(s.sensor, rotation=TILTED)),
        r"order of the rows\)$",
        0.01,
    ),
    "place in the map given": (
        lambda s: (moved(s.cloud, (300.0, 120.0, 5.0)), replace(s.sensor, origin_m=(300.0, 120.0, 5.0))),
        r"order of the rows\)$",
        0.01,
    ),
    "compensated for 5 m/s": (
        lambda s: (compensated(s.cloud, 0.5), s.sensor),
        r"compensated for motion of \(\+0\.50, [+-]0\.0\d\) m a turn, taken out to find the beams\)$",
        0.01,
    ),
    "compensated for 10 m/s, to the end": (
        lambda s: (compensated(s.cloud, 1.0, moment=1.0), s.sensor),
        r"compensated for motion of \(\+(0\.99|1\.0\d), [+-]0\.\d\d\) m a turn, taken out to find the beams\)$",
        0.03,
    ),
    "compensated for 15 m/s": (
        lambda s: (compensated(s.cloud, 1.5), s.sensor),
        r"compensated for motion of \(\+1\.(49|50), [+-]0\.\d\d\) m a turn, taken out to find the beams\)$",
        0.025,
    ),
    "ring column in no order": (
        lambda s: (shuffled(with_ring(s, 1.0)), replace(_numbered_as_the_sweep(s), ring_column=4)),
        r"rings from the ring column\)$",
        0.01,
    ),
    "elevations 0.2 degree off, in no order": (
        lambda s: (shuffled(s.cloud), replace(s.sensor, elevations_deg=_higher(s.sensor, 0.2))),
        r"from the (sweep|elevations)",
        0.01,
    ),
    "a tenth of the rows twice": (
        lambda s: (torch.cat([s.cloud, s.cloud[::10]]), s.sensor),
        r"\d+ rows are further echoes of a beam and meet the same particles\)$",
        0.01,
    ),
    "second echoes of a tenth": (
        lambda s: (second_echoes(s, 10), s.sensor),
        r"\d+ rows are further echoes of a beam and meet the same particles\)$",
        0.01,
    ),
}


def _higher(sensor: Lidar, degrees: float) -> tuple[float, ...]:
    return tuple(e + degrees for e in sensor.elevations_deg or ())


def _numbered_as_the_sweep(given: Sweep) -> Lidar:
    """The sensor, its rings in the order in which the sweep numbers them."""
    rank = torch.argsort(torch.argsort(_elevations(given))).tolist()
    low_to_high = np.argsort(given.sensor.elevations_deg or ())
    order = [int(low_to_high[place]) for place in rank]
    fields = ("elevations_deg", "origin_heights_m", "azimuth_offsets_deg")
    values = {name: getattr(given.sensor, name) for name in fields}
    return replace(given.sensor, **{k: tuple(v[i] for i in order) for k, v in values.items() if v is not None})


@pytest.mark.parametrize("name", COMPLETED)
def test_a_sweep_that_can_be_completed_is(given: Sweep, name: str) -> None:
    change, words, tolerance = COMPLETED[name]
    cloud, sensor = change(given)
    snow = LidarSnow(Snow(rate_mm_per_h=1.0), sensor, complete_scan=True)
    result = snow.run(cloud, snow.draw(cloud, seed=1))
    appended = result.kind.shape[0] - len(cloud)
    assert appended == pytest.approx(given.missing, rel=tolerance)
    assert_words(result.scan, words)


def assert_words(scan: str, pattern: str) -> None:
    assert re.search(pattern, scan), scan


@pytest.mark.parametrize(
    ("sector", "covered"), [((-90.0, 90.0), 180), ((0.0, 180.0), 180), ((-45.0, 45.0), 90), ((-150.0, 150.0), 300)]
)
def test_nothing_is_appended_where_the_sweep_does_not_look(
    given: Sweep, sector: tuple[float, float], covered: int
) -> None:
    azimuth = azimuth_deg(given.cloud)
    inside = (azimuth > sector[0]) & (azimuth < sector[1])
    found = complete_scan(given.cloud[inside], given.sensor)
    assert_words(found.words, rf"the sweep covers {covered} of 360 degrees of azimuth, nothing is appended elsewhere")
    middle, half = 0.5 * (sector[0] + sector[1]), 0.5 * (sector[1] - sector[0])
    away = (azimuth_deg(found.direction) - middle + 180.0) % 360.0 - 180.0
    assert float(away.abs().max()) < half + 360.0 / (given.sensor.columns or 1)
    assert 0 < len(found.direction) < given.missing


def test_echoes_of_a_beam_share_their_fate_though_rows_are_fewer_than_beams(given: Sweep) -> None:
    cloud = torch.cat([given.cloud, given.cloud[::10]])
    snow = LidarSnow(Snow(rate_mm_per_h=2.0, flake_reflectivity=0.9), given.sensor, complete_scan=True)
    result = snow.run(cloud, snow.draw(cloud, seed=3))
    kind, copies = result.kind[: len(cloud)], result.kind[len(given.cloud) : len(cloud)]
    assert isinstance(kind, Tensor)
    assert isinstance(copies, Tensor)
    assert torch.equal(kind[: len(given.cloud)][::10], copies)
    assert int((copies == PointKind.PARTICLE).sum()) > 10


def as_floats(pattern: str, columns: int) -> Tensor:
    return torch.from_numpy(np.fromfile(recording(pattern), np.float32).reshape(-1, columns).copy())


RECORDED = {
    "velodyne-hdl-64e": lambda: read_kitti_points(recording("kitti_13/velodyne/000008.bin")),
    "velodyne-hdl-32e": lambda: as_floats("kitti_nuscenes_demo/nuscenes/*.pcd.bin", 5),
    "pandar64-wads": lambda: as_floats("wads_snow/velodyne/042223.bin", 4),
}


@pytest.mark.real_data
@pytest.mark.parametrize("preset", ["velodyne-vlp-16", "velodyne-hdl-32e", "velodyne-hdl-64e", "ouster-os1-128"])
@pytest.mark.parametrize("own", RECORDED)
def test_a_recorded_sweep_of_another_sensor_is_refused_with_its_preset(own: str, preset: str) -> None:
    cloud = RECORDED[own]()
    sensor = Lidar.preset(preset, ring_column=4 if cloud.shape[1] > 4 else None)
    if own == preset:
        pytest.skip("its own preset")
    # Ring numbers of the HDL-32E are too many for a VLP-16: that is seen before the elevations are looked at.
    sentence = rf"The rings are those of {own}: take that preset|expected ring numbers 0 to 15 .*torchweather list"
    with pytest.raises(ValueError, match=sentence):
        complete_scan(cloud, sensor)


def test_a_made_sweep_of_an_ouster_as_a_pandar_names_the_ouster() -> None:
    own = Lidar.preset("ouster-os1-128")
    points, _ = sweep(np.asarray(own.elevations_deg), np.asarray(own.origin_heights_m), 1024)
    with pytest.raises(ValueError, match=r"has 64 rings .* shows 128 rings .*those of ouster-os1-128: take that"):
        complete_scan(torch.from_numpy(points), Lidar.preset("pandar64-wads"))


# A cloud of a map is out of the sensor's reach, which is looked at first.
AT_THE_COMMAND_LINE = {"map's frame": r"19400 of 19400 returns lie farther than 1\.5 times .*--sensor-origin X Y Z"}


@pytest.mark.parametrize("name", ["map's frame", "every second column", "tilted by 5 degrees"])
def test_the_command_line_refuses_in_one_line_and_writes_nothing(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = made()
    change, sentence = REFUSED[name]
    cloud, _ = change(given)
    cloud.numpy().astype(np.float32).tofile(tmp_path / "a.bin")
    sensor = tmp_path / "my.yaml"
    given.cloud.numpy().tofile(tmp_path / "clear.bin")
    fit = ["fit-sensor", str(tmp_path / "clear.bin"), "--sensor", "lidar:velodyne-hdl-64e", "--out", str(sensor)]
    assert main([*fit, "--quiet"]) == 0
    capsys.readouterr()
    out = tmp_path / "out"
    arguments = ["--weather", "snow:rate=1", "--sensor", f"lidar:{sensor}", "--intensity-unit", "reflectivity"]
    assert main(["apply", str(tmp_path / "a.bin"), *arguments, "--complete-scan", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert_words(error, rf"a\.bin: .*{AT_THE_COMMAND_LINE.get(name, sentence)}")
    assert not [path for path in out.rglob("*") if path.is_file()]
    assert main(["apply", str(tmp_path / "clear.bin"), *arguments, "--complete-scan", "--out", str(out)]) == 0


# What fit-sensor must say of a sweep: as an error (exit code 2), or as a note.
FITTED: dict[str, tuple[Change, int, str]] = {
    "map's frame": (
        REFUSED["map's frame"][0],
        2,
        r"expected a sweep in its sensor's frame; the sensor stands at \(300\.00, 120\.00, .*Subtract that place",
    ),
    "above the ground of a map": (
        REFUSED["above the ground of a map"][0],
        2,
        r"its beams start 5\.\d\d m above the cloud's origin\. Subtract that from z",
    ),
    "tilted by 5 degrees": (
        REFUSED["tilted by 5 degrees"][0],
        2,
        r"the cloud is tilted by (4\.9|5\.0) degrees against its sensor\. Turn it level",
    ),
    "written twice": (REFUSED["written twice"][0], 2, r"returns repeat other rows of the file.*Drop the copies"),
    "half a turn": (
        lambda s: (s.cloud[s.cloud[:, 0] > 0], s.sensor),
        0,
        r"No ring has a point at azimuths of 90 to 270 degrees: a blocked sector, or a part of a turn",
    ),
    "second echoes": (lambda s: (second_echoes(s, 5), s.sensor), 0, r"the file has two echoes a beam"),
}


@pytest.mark.parametrize("name", FITTED)
def test_fit_sensor_says_what_does_not_fit(
    given: Sweep, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, code, sentence = FITTED[name]
    change(given)[0].numpy().tofile(tmp_path / "a.bin")
    out = tmp_path / "my.yaml"
    arguments = ["fit-sensor", str(tmp_path / "a.bin"), "--sensor", "lidar:velodyne-hdl-64e", "--out", str(out)]
    assert main(arguments) == code
    assert out.exists() == (code == 0)
    assert_words(capsys.readouterr().err, sentence)


def test_fit_sensor_names_the_preset_of_the_rings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = Lidar.preset("velodyne-vlp-16")
    sweep(np.asarray(own.elevations_deg), np.zeros(16), 1800)[0].tofile(tmp_path / "a.bin")
    fit = ["fit-sensor", str(tmp_path / "a.bin"), "--out", str(tmp_path / "my.yaml"), "--sensor"]
    assert main([*fit, "lidar:velodyne-hdl-32e"]) == 0
    assert_words(
        capsys.readouterr().err, r"rings are those of velodyne-vlp-16; .*Give --sensor lidar:velodyne-vlp-16\."
    )
    assert main([*fit, "lidar:velodyne-vlp-16"]) == 0
    assert "rings are those of" not in capsys.readouterr().err
