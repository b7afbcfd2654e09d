"""Radar detections: nuScenes' PCD byte for byte, csv and NPZ in their columns, power and RCS by the radar equation.

No sweep of nuScenes is at hand: the files are built with the header that its development kit documents
(RadarPointCloud.from_file), with a line feed behind the last point, because the kit wants a byte there.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.io import NUSCENES_RADAR_STATES, RADAR_COLUMNS, RadarPoints, read_radar, write_radar
from torchweather.sensors import Radar

HEADER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms vy_rms
SIZE 4 4 4 1 2 4 4 4 4 4 1 1 1 1 1 1 1 1
TYPE F F F I I F F F F F I I I I I I I I
COUNT 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1 1
WIDTH {count}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {count}
DATA binary
"""  # noqa: E501
NAMES = HEADER.splitlines()[2].split()[1:]
KINDS = {"F4": "<f4", "I1": "i1", "I2": "<i2"}
ROW = np.dtype(
    [
        (name, KINDS[letter + size])
        for name, size, letter in zip(
            NAMES, HEADER.splitlines()[3].split()[1:], HEADER.splitlines()[4].split()[1:], strict=True
        )
    ]
)
RADAR = Radar(transmit_power_dbm=12.0, antenna_gain_dbi=13.0)
AT_50_M_DBM = -111.1285  # PHYSICS.md 6.2: 12 dBm, 13 dBi twice, 1 m^2 at 50 m, 77 GHz


def sweep(count: int = 40) -> np.ndarray:
    draw = np.random.default_rng(count)
    rows = np.zeros(count, ROW)
    rows["x"], rows["y"] = draw.uniform(1, 90, count), draw.uniform(-60, 60, count)
    rows["rcs"] = np.round(draw.uniform(-10, 30, count) * 2) / 2
    for name in ("vx", "vy", "vx_comp", "vy_comp"):
        rows[name] = draw.uniform(-20, 20, count)
    rows["id"], rows["dyn_prop"] = np.arange(count), draw.integers(0, 8, count)
    rows["ambig_state"], rows["invalid_state"] = draw.integers(0, 5, count), draw.integers(0, 18, count)
    for name in ("x_rms", "y_rms", "pdh0", "vx_rms", "vy_rms"):
        rows[name] = draw.integers(0, 20, count)
    return rows


def nuscenes(path: Path, rows: np.ndarray, behind: bytes = b"\n") -> Path:
    path.write_bytes(HEADER.format(count=len(rows)).encode() + rows.tobytes() + behind)
    return path


# ---- nuScenes ------------------------------------------------------------------------------------------------------


def test_a_sweep_has_six_numbers_and_all_its_columns(tmp_path: Path) -> None:
    rows = sweep()
    found = read_radar(nuscenes(tmp_path / "a.pcd", rows), RADAR)
    assert found.columns == (*RADAR_COLUMNS, *(name for name in NAMES if name not in ("x", "y", "z", "rcs")))
    assert found.points.dtype == torch.float32
    for name, stored in (("x_m", "x"), ("y_m", "y"), ("rcs_dbsm", "rcs"), ("pdh0", "pdh0"), ("vy_comp", "vy_comp")):
        assert found.column(name).tolist() == rows[stored].tolist()
    assert (found.power_source, found.rcs_source, found.speed_source) == ("radar equation", "file", "relative")


@pytest.mark.parametrize(("speed", "names"), [("relative", ("vx", "vy")), ("compensated", ("vx_comp", "vy_comp"))])
def test_the_speed_is_the_velocity_along_the_line_of_sight(tmp_path: Path, speed: str, names: tuple[str, str]) -> None:
    rows = sweep(3)
    rows["x"], rows["y"] = [3.0, 30.0, 0.0], [4.0, 0.0, 8.0]
    rows[names[0]], rows[names[1]] = [5.0, -7.0, 9.0], [10.0, 9.0, -2.0]
    found = read_radar(nuscenes(tmp_path / "a.pcd", rows), RADAR, speed=speed)
    assert found.column("speed_m_per_s").tolist() == [11.0, -7.0, -2.0]  # (3 * 5 + 4 * 10) / 5, receding is positive
    assert found.speed_source == speed


def test_the_power_is_the_radar_equations(tmp_path: Path) -> None:
    rows = sweep(3)
    rows["x"], rows["y"], rows["rcs"] = [50.0, 100.0, 50.0], 0.0, [0.0, 0.0, 10.0]
    power = read_radar(nuscenes(tmp_path / "a.pcd", rows), RADAR).column("power_dbm")
    # Rounded in float32 (8e-6 at 111) and in the five digits after the point of the expectation.
    expected = torch.tensor([AT_50_M_DBM, AT_50_M_DBM - 40 * math.log10(2), AT_50_M_DBM + 10])
    torch.testing.assert_close(power, expected, rtol=0, atol=1e-4)
    # Half the frequency, 3 dB more sent, 4 dB lost: each enters once, the wavelength squared.
    other = replace(RADAR, frequency_ghz=38.5, transmit_power_dbm=15.0, loss_db=4.0)
    change = read_radar(tmp_path / "a.pcd", other).column("power_dbm") - power
    torch.testing.assert_close(change, torch.full((3,), 20 * math.log10(2) + 3 - 4), rtol=0, atol=1e-4)


def test_the_pattern_weakens_what_is_seen_aside_on_both_ways(tmp_path: Path) -> None:
    rows = sweep(2)
    half = math.radians(RADAR.azimuth_beamwidth_deg / 2)
    rows["x"], rows["y"], rows["rcs"] = [50.0, 50 * math.cos(half)], [0.0, 50 * math.sin(half)], 0.0
    path = nuscenes(tmp_path / "a.pcd", rows)
    flat, shaped = (read_radar(path, RADAR, gain=gain).column("power_dbm") for gain in ("boresight", "pattern"))
    # Half the power on each way at half the width; float32 as above.
    torch.testing.assert_close(flat - shaped, torch.tensor([0.0, 20 * math.log10(2)]), rtol=0, atol=1e-4)


@pytest.mark.parametrize("behind", [b"", b"\n"])
def test_a_sweep_comes_back_byte_for_byte(tmp_path: Path, behind: bytes) -> None:
    source = nuscenes(tmp_path / "a.pcd", sweep(), behind)
    write_radar(tmp_path / "b.pcd", read_radar(source, RADAR))
    assert (tmp_path / "b.pcd").read_bytes() == source.read_bytes()


def test_only_what_changed_is_written_otherwise(tmp_path: Path) -> None:
    rows = sweep()
    found = read_radar(nuscenes(tmp_path / "a.pcd", rows), RADAR)
    points = found.points.clone()
    points[3, :3] = 0.0  # not detected any more
    points[5, 5] = 7.5
    points[6, 4] -= 3.0  # the file has no power
    write_radar(tmp_path / "b.pcd", found.with_points(points))
    rows["rcs"][5] = 7.5
    expected = nuscenes(tmp_path / "c.pcd", np.delete(rows, 3))
    assert (tmp_path / "b.pcd").read_bytes() == expected.read_bytes()


@pytest.mark.parametrize("speed", ["relative", "compensated"])
def test_a_changed_speed_goes_into_both_velocities_along_the_line_of_sight(tmp_path: Path, speed: str) -> None:
    rows = sweep()
    found = read_radar(nuscenes(tmp_path / "a.pcd", rows), RADAR, speed=speed)
    points = found.points.clone()
    points[1, 3] += 2.0
    write_radar(tmp_path / "b.pcd", found.with_points(points))
    again = np.frombuffer((tmp_path / "b.pcd").read_bytes()[len(HEADER.format(count=40)) :], ROW, 40)
    assert np.array_equal(np.delete(again, 1), np.delete(rows, 1))
    sight = np.array([rows["x"][1], rows["y"][1]], np.float64)
    sight /= np.hypot(*sight)
    for pair in (("vx", "vy"), ("vx_comp", "vy_comp")):
        change = [float(again[name][1]) - float(rows[name][1]) for name in pair]
        np.testing.assert_allclose(change, 2.0 * sight, atol=1e-5)  # float32 of 20 m/s: steps of 2e-6
    torch.testing.assert_close(
        read_radar(tmp_path / "b.pcd", RADAR, speed=speed).points[1, 3], points[1, 3], rtol=0, atol=1e-5
    )


def test_all_rows_are_read_unless_states_are_named(tmp_path: Path) -> None:
    rows = sweep(400)
    path = nuscenes(tmp_path / "a.pcd", rows)
    assert len(read_radar(path, RADAR).points) == 400
    kept = (rows["invalid_state"] == 0) & (rows["dyn_prop"] <= 6) & (rows["ambig_state"] == 3)
    found = read_radar(path, RADAR, keep=NUSCENES_RADAR_STATES)
    assert 0 < kept.sum() < 400
    assert found.column("id").tolist() == rows["id"][kept].tolist()
    write_radar(tmp_path / "b.pcd", found)
    assert (tmp_path / "b.pcd").read_bytes() == nuscenes(tmp_path / "c.pcd", rows[kept]).read_bytes()
    with pytest.raises(TorchweatherError, match=r"column 'dynprop'.*Did you mean 'dyn_prop'"):
        read_radar(path, RADAR, keep={"dynprop": (0,)})


def test_an_empty_sweep_is_a_row_of_nan(tmp_path: Path) -> None:
    rows = sweep(1)
    for name in NAMES:
        rows[name] = np.nan if ROW[name].kind == "f" else 0
    source = nuscenes(tmp_path / "a.pcd", rows)
    empty = read_radar(source, RADAR)
    assert empty.points[0, :6].tolist() == [0.0] * 6
    write_radar(tmp_path / "b.pcd", empty)
    assert (tmp_path / "b.pcd").read_bytes() == source.read_bytes()
    # A sweep of which the weather left nothing is written so too.
    found = read_radar(nuscenes(tmp_path / "c.pcd", sweep()), RADAR)
    write_radar(tmp_path / "d.pcd", found.with_points(torch.zeros_like(found.points)))
    assert (tmp_path / "d.pcd").read_bytes() == source.read_bytes()


def test_a_row_that_no_record_stands_behind_gets_its_velocity_from_its_speed(tmp_path: Path) -> None:
    found = read_radar(nuscenes(tmp_path / "a.pcd", sweep(2)), RADAR)
    clutter = torch.zeros(1, found.points.shape[1])
    clutter[0, :6] = torch.tensor([3.0, 4.0, 0.0, -10.0, -100.0, -30.0])
    write_radar(tmp_path / "b.pcd", found.with_points(torch.cat([found.points, clutter])))
    again = read_radar(tmp_path / "b.pcd", RADAR)
    # 10 m/s along (3, 4) / 5; float32.
    torch.testing.assert_close(
        again.points[2, [again.columns.index(n) for n in ("vx", "vy")]], torch.tensor([-6.0, -8])
    )
    torch.testing.assert_close(again.points[2, [0, 1, 2, 3, 5]], clutter[0, [0, 1, 2, 3, 5]])


# ---- csv, NPZ, PCD by the names of their columns -------------------------------------------------------------------


def test_a_csv_with_both_needs_no_radar_and_keeps_its_text(tmp_path: Path) -> None:
    text = "X_m,y_m,z_m,speed_m_per_s,power_dBm,rcs_dbsm,class\n10.5,-2.25,0.125,-3.5,-80,4.5,2\n60,1,0,12,-101.7,0,1\n"
    (tmp_path / "a.csv").write_text(text)
    found = read_radar(tmp_path / "a.csv")
    assert found.columns == (*RADAR_COLUMNS, "class")
    assert found.points[0].tolist() == [10.5, -2.25, 0.125, -3.5, -80.0, 4.5, 2.0]
    assert (found.power_source, found.rcs_source, found.speed_source) == ("file", "file", "file")
    write_radar(tmp_path / "b.csv", found)
    assert (tmp_path / "b.csv").read_text() == text


@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_range_and_angles_become_a_position_and_come_back(tmp_path: Path, unit: str) -> None:
    scale = 1.0 if unit == "rad" else math.degrees(1.0)
    azimuth, elevation = 0.25, -0.125
    header = f"range_m,azimuth_{unit},elevation_{unit},speed_m_per_s,rcs_dbsm"
    rows = [(20.0, azimuth * scale, elevation * scale, 1.5, 10.0), (30.0, 0.0, 0.0, 0.0, -5.0)]
    text = "".join(",".join(repr(value).removesuffix(".0") for value in row) + "\n" for row in rows)
    (tmp_path / "a.csv").write_text(f"{header}\n{text}")
    found = read_radar(tmp_path / "a.csv", RADAR)
    flat = 20 * math.cos(elevation)
    expected = [flat * math.cos(azimuth), flat * math.sin(azimuth), 20 * math.sin(elevation)]
    np.testing.assert_allclose(found.points[0, :3].numpy(), expected, rtol=2e-7)  # float32
    write_radar(tmp_path / "b.csv", found)
    assert (tmp_path / "b.csv").read_text() == (tmp_path / "a.csv").read_text()
    # Twice as far to the left and up: the angles stay, the range doubles; the other row keeps its numbers.
    moved = found.points.clone()
    moved[0, :3] *= 2
    write_radar(tmp_path / "c.csv", found.with_points(moved))
    written = np.loadtxt(tmp_path / "c.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written[0], [40.0, *rows[0][1:]], rtol=1e-6)
    assert written[1].tolist() == list(rows[1])


@pytest.mark.parametrize(("known", "other"), [("rcs_dbsm", "power_dbm"), ("power_dbm", "rcs_dbsm")])
def test_power_and_cross_section_give_each_other(tmp_path: Path, known: str, other: str) -> None:
    value = 3.0 if known == "rcs_dbsm" else AT_50_M_DBM + 3.0
    arrays = {name: np.array([number]) for name, number in (("x_m", 30.0), ("y_m", -40.0), ("z_m", 0.0))}
    np.savez(tmp_path / "a.npz", **arrays, speed_m_per_s=np.zeros(1), **{known: np.array([value])})
    with pytest.raises(TorchweatherError, match=rf"a\.npz: expected {other}; the file has none.*radar=Radar"):
        read_radar(tmp_path / "a.npz")
    found = read_radar(tmp_path / "a.npz", RADAR)
    expected = torch.tensor([AT_50_M_DBM + 3.0, 3.0], dtype=found.points.dtype)
    torch.testing.assert_close(found.points[0, 4:6], expected, rtol=0, atol=1e-4)
    assert {known: "file", other: "radar equation"} == {
        "power_dbm": found.power_source,
        "rcs_dbsm": found.rcs_source,
    }
    write_radar(tmp_path / "b.npz", found)
    with np.load(tmp_path / "b.npz") as written:
        assert set(written.files) == {*arrays, "speed_m_per_s", known}
    write_radar(tmp_path / "c.npz", found, columns=RADAR_COLUMNS)
    assert read_radar(tmp_path / "c.npz").points[0].tolist() == found.points[0, :6].tolist()


def test_detections_of_a_frame_with_nan_where_none_was(tmp_path: Path) -> None:
    """Keys of one target each; NaN in the power is no detection, and other arrays are of another shape."""
    arrays = {
        "range_m": np.array([50.0, 20.0]),
        "azimuth_rad": np.array([0.0, 0.5]),
        "elevation_rad": np.array([0.0, 0.25]),
        "speed_m_per_s": np.array([1.0, 2.0]),
        "power_db": np.array([AT_50_M_DBM, np.nan]),
    }
    np.savez(tmp_path / "a.npz", **arrays, noise_floor_db=np.array(-130.0), clutter=np.zeros((5, 6)))
    found = read_radar(tmp_path / "a.npz", RADAR)
    assert found.columns[:6] == (*RADAR_COLUMNS[:4], "power_db", "rcs_dbsm")
    assert found.points[1, :6].tolist() == [0.0] * 6
    assert abs(float(found.points[0, 5])) < 1e-4  # dBsm: the expectation's digits
    write_radar(tmp_path / "b.npz", found)
    with np.load(tmp_path / "b.npz") as written:
        for name, array in arrays.items():
            assert np.array_equal(written[name], array, equal_nan=True), name
    # Of two targets one is lost: the row goes, the one that was none stays.
    write_radar(tmp_path / "c.npz", found.with_points(torch.zeros_like(found.points)))
    with np.load(tmp_path / "c.npz") as written:
        assert np.isnan(written["power_db"]).tolist() == [True]


@pytest.mark.parametrize("name", ["a.csv", "a.npz", "a.pcd"])
@pytest.mark.parametrize("rows", [0, 1, 30])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_tensor_comes_back_bit_for_bit(tmp_path: Path, name: str, rows: int, dtype: torch.dtype) -> None:
    points = torch.randn(rows, 6, generator=torch.Generator().manual_seed(rows), dtype=dtype) * 30
    write_radar(tmp_path / name, points)
    found = read_radar(tmp_path / name)
    if rows:
        assert found.points.dtype == dtype
    assert torch.equal(found.points.to(dtype), points)
    assert found.columns == RADAR_COLUMNS
    write_radar(tmp_path / f"b{name}", found)
    assert (tmp_path / f"b{name}").read_bytes() == (tmp_path / name).read_bytes()


@pytest.mark.parametrize("target", ["b.csv", "b.npz", "b.pcd"])
def test_another_format_takes_all_columns(tmp_path: Path, target: str) -> None:
    found = read_radar(nuscenes(tmp_path / "a.pcd", sweep()), RADAR)
    write_radar(tmp_path / target, found, columns=found.columns if target == "b.pcd" else None)
    again = read_radar(tmp_path / target)
    assert again.columns == found.columns
    assert torch.equal(again.points, found.points)
    assert again.power_source == "file"


def test_a_table_without_names_is_the_six_and_more(tmp_path: Path) -> None:
    table = np.arange(1, 15, dtype=np.float32).reshape(2, 7)
    np.savez(tmp_path / "a.npz", points=table)
    found = read_radar(tmp_path / "a.npz")
    assert found.columns == (*RADAR_COLUMNS, "column_6")
    assert torch.equal(found.points, torch.from_numpy(table))


# ---- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("x_m,y_m,speed_m_per_s,rcs_dbsm", "1,2,3,4", "expected a position.*column of zeros"),
        ("x_m,y_m,z_m,rcs_dbsm", "1,2,3,4", "expected a speed, a column speed_m_per_s"),
        ("x_m,y_m,z_m,vx_comp,vy_comp,rcs_dbsm", "1,2,3,4,5,6", r"vx and vy \(m/s, speed='relative'\)"),
        ("x_m,y_m,z_m,speed_m_per_s", "1,2,3,4", r"expected a power .* or a radar cross section"),
        ("range_m,azimuth_deg,elevation_deg,speed_m_per_s,rcs_dbsm", "-2,0,0,0,0", "range_m of 0 m or more; got -2 m"),
        ("x_m,y_m,z_m,speed_m_per_s,rcs_dbsm", "1,nan,3,4,5", "y_m = nan in row 0"),
        ("x_m,y_m,z_m,speed_m_per_s,rcs_dbsm", "1,2,3,4,nan", "rcs_dbsm = nan in row 0"),
        ("x_m,y_m,z_m,speed_m_per_s,power_dbm", "1,2,3,inf,4", "speed_m_per_s = inf in row 0"),
        ("x_m,y_m,z_m,speed_m_per_s,x_m,power_dbm", "1,2,3,3,3,4", "'x_m' twice"),
        ("1,2,3,4,5,6", "1,2,3,4,5,6", "expected a line of names, such as x_m,y_m"),
    ],
)
def test_a_list_that_is_none_is_refused(tmp_path: Path, header: str, row: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(f"{header}\n{row}\n")
    with pytest.raises(TorchweatherError, match=rf"a\.csv: .*{message}"):
        read_radar(tmp_path / "a.csv", RADAR)


def test_wrong_arguments_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"must end in \.pcd, \.npz, \.csv, \.bin; got 'a\.xyz'"):
        read_radar(tmp_path / "a.xyz")
    for name, value in (("speed", "radial"), ("gain", "beam"), ("format", "ply")):
        with pytest.raises(ValueError, match=rf"read_radar: {name} must be one of"):
            read_radar(tmp_path / "a.csv", **{name: value})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"shape \(N, 6 or more\).*got torch.float32 \(3, 5\)"):
        write_radar(tmp_path / "a.csv", torch.zeros(3, 5))
    with pytest.raises(ValueError, match="columns must be 6 different names"):
        RadarPoints(torch.zeros(1, 6), ("x_m",))
    with pytest.raises(ValueError, match="columns must be one of x_m"):
        write_radar(tmp_path / "a.csv", torch.ones(1, 6), columns=("x", "y"))
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_radar(tmp_path / "none.csv")
    np.savez(tmp_path / "a.npz", points=np.ones((2, 3, 6)))
    with pytest.raises(TorchweatherError, match=r"got a grid \(2, 3\)"):
        read_radar(tmp_path / "a.npz")


def test_a_number_that_a_field_cannot_hold_is_refused(tmp_path: Path) -> None:
    found = read_radar(nuscenes(tmp_path / "a.pcd", sweep()), RADAR)
    points = found.points.clone()
    points[0, found.columns.index("pdh0")] = 0.5
    with pytest.raises(TorchweatherError, match="field 'pdh0' is int8"):
        write_radar(tmp_path / "b.pcd", found.with_points(points))
    assert not (tmp_path / "b.pcd").exists()


@pytest.mark.filterwarnings("ignore:.* its VIEWPOINT")  # a damaged one that is read all the same
@pytest.mark.parametrize("name", ["a.pcd", "a.csv", "a.npz"])
@given(data=st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_broken_file_is_refused_or_read_but_never_crashes(tmp_path: Path, name: str, data: st.DataObject) -> None:
    path = tmp_path / name
    if name == "a.pcd":
        nuscenes(path, sweep(4))
    else:
        write_radar(path, torch.arange(24.0).reshape(4, 6) + 1.0)
    whole = bytearray(path.read_bytes())
    for place, value in data.draw(
        st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), min_size=1, max_size=6)
    ):
        whole[place] = value
    start = data.draw(st.integers(0, len(whole)))
    path.write_bytes(whole[:start] + whole[start + data.draw(st.sampled_from([0, 0, 1, 50])) :])
    try:
        found = read_radar(path, RADAR)
    except TorchweatherError as error:
        assert name in str(error)  # noqa: PT017
    else:
        assert bool(found.points[:, :6].isfinite().all())


def test_a_viewpoint_of_detections_is_warned_of(tmp_path: Path) -> None:
    columns = ("x_m", "y_m", "z_m", "speed_m_per_s", "power_dbm", "rcs_dbsm")
    write_radar(tmp_path / "a.pcd", torch.tensor([[10.0, 0, 0, -3, -80, 10]]), columns=columns)
    content = (tmp_path / "a.pcd").read_bytes().replace(b"VIEWPOINT 0 0 0", b"VIEWPOINT 2 0 0")
    (tmp_path / "a.pcd").write_bytes(content)
    with pytest.warns(TorchweatherWarning, match="VIEWPOINT, 2 0 0 1 0 0 0, is not applied"):
        assert read_radar(tmp_path / "a.pcd").points[0, 0] == 10
