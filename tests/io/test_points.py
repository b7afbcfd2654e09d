"""Points of every format: round trips, columns, dtypes, NaN rows, bad files, speed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.io.point_cloud import INTENSITY_NAMES, PointCloud
from torchweather.io.points import POINT_SUFFIXES, read_points, write_points
from torchweather.io.stored_points import PointField, PointLayout

FILES = (
    ("a.bin", None),
    ("a.pcd.bin", None),
    ("a.pcd", "ascii"),
    ("a.pcd", "binary"),
    ("a.pcd", "binary_compressed"),
    ("a.ply", "ascii"),
    ("a.ply", "binary_little_endian"),
    ("a.ply", "binary_big_endian"),
    ("a.npz", "table"),
    ("a.npz", "table_compressed"),
    ("a.npz", "columns"),
    ("a.npz", "columns_compressed"),
    ("a.csv", None),
)
every_file = pytest.mark.parametrize(("name", "encoding"), FILES, ids=lambda value: str(value))
with_header = pytest.mark.parametrize(("name", "encoding"), FILES[2:], ids=lambda value: str(value))
XYZI = ("x", "y", "z", "intensity")


def cloud_like(name: str, rows: int = 50) -> torch.Tensor:
    columns = 5 if name.endswith(".pcd.bin") else 4
    points = torch.randn(rows, columns, generator=torch.Generator().manual_seed(rows)) * 30
    points[:, 3] = points[:, 3].abs().floor()
    return points


@every_file
@pytest.mark.parametrize("rows", [1, 50])
def test_a_tensor_comes_back_bit_for_bit_and_the_file_too(
    tmp_path: Path, name: str, encoding: str | None, rows: int
) -> None:
    points = cloud_like(name, rows)
    write_points(tmp_path / name, points, encoding=encoding)
    found = read_points(tmp_path / name)
    assert torch.equal(found.points, points)
    assert found.points.dtype == torch.float32
    assert found.columns == (*XYZI, "ring")[: points.shape[1]]
    again = tmp_path / f"again_{name}"
    write_points(again, found)
    assert again.read_bytes() == (tmp_path / name).read_bytes()
    assert [path for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@with_header
def test_an_empty_cloud_is_a_cloud_where_a_header_says_so(tmp_path: Path, name: str, encoding: str | None) -> None:
    write_points(tmp_path / name, torch.zeros(0, 4), encoding=encoding)
    found = read_points(tmp_path / name)
    assert found.points.shape == (0, 4)
    assert found.columns == XYZI


@pytest.mark.parametrize("name", ["a.bin", "a.pcd.bin", "a.csv"])
def test_an_empty_file_without_a_header_is_refused_and_not_written(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"")
    with pytest.raises(TorchweatherError, match=rf"{name}.*empty"):
        read_points(tmp_path / name)
    if name != "a.csv":
        with pytest.raises(TorchweatherError, match="cannot hold an empty cloud"):
            write_points(tmp_path / f"b{name}", cloud_like(name)[:0])


@with_header
def test_nan_rows_become_range_zero_and_come_back_as_nan(tmp_path: Path, name: str, encoding: str | None) -> None:
    points = cloud_like(name, 12)
    points[[2, 5], :3] = torch.nan
    points[5, 3] = torch.nan
    write_points(tmp_path / name, points, encoding=encoding)
    found = read_points(tmp_path / name)
    assert found.nan_rows == 2
    assert torch.equal(found.points[[2, 5], :3], torch.zeros(2, 3))
    assert found.points[5, 3] == 0
    write_points(tmp_path / f"again_{name}", found)
    assert (tmp_path / f"again_{name}").read_bytes() == (tmp_path / name).read_bytes()
    # A particle in the empty beam stays one, and the other beam is NaN again.
    hit = found.points.clone()
    hit[2, :3] = torch.tensor([5.0, 0, 0])
    write_points(tmp_path / f"hit_{name}", found.with_points(hit))
    written = read_points(tmp_path / f"hit_{name}")
    assert written.nan_rows == 1
    assert written.points[2, 0] == 5


@every_file
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_position_that_is_partly_no_number_is_refused(
    tmp_path: Path, name: str, encoding: str | None, value: float
) -> None:
    points = cloud_like(name, 12)
    with pytest.raises(TorchweatherError, match=r"finite"):  # noqa: PT012
        points[7, 1] = value
        write_points(tmp_path / name, points, encoding=encoding)
        read_points(tmp_path / name)


@every_file
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.7, 0.95])
def test_a_truncated_file_is_named(tmp_path: Path, name: str, encoding: str | None, keep: float) -> None:
    write_points(tmp_path / name, cloud_like(name), encoding=encoding)
    whole = (tmp_path / name).read_bytes()
    size = int(keep * len(whole))
    if name == "a.csv" and keep:  # it may end after any row; but not within a number and a comma
        size = whole.rindex(b",", 0, size) + 1
    (tmp_path / name).write_bytes(whole[: size - size % 4 + 2 if name.endswith(".bin") else size])
    with pytest.raises(TorchweatherError, match=name):
        read_points(tmp_path / name)


@every_file
@given(noise=st.binary(min_size=1, max_size=200))
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_garbage_is_refused_or_read_but_never_crashes(
    tmp_path: Path, name: str, encoding: str | None, noise: bytes
) -> None:
    (tmp_path / name).write_bytes(noise)
    try:
        read_points(tmp_path / name)
    except TorchweatherError as error:
        assert name in str(error)  # noqa: PT017


@every_file
@given(places=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_bytes_are_refused_or_read_but_never_crash(
    tmp_path: Path, name: str, encoding: str | None, places: list[tuple[float, int]]
) -> None:
    write_points(tmp_path / name, cloud_like(name, 5), encoding=encoding)
    content = bytearray((tmp_path / name).read_bytes())
    for place, value in places:
        content[min(int(place * len(content)), len(content) - 1)] = value
    (tmp_path / name).write_bytes(content)
    try:
        read_points(tmp_path / name)
    except TorchweatherError as error:
        assert name in str(error)  # noqa: PT017


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz"])
@given(
    points=hnp.arrays(
        np.float32,
        st.tuples(st.integers(0, 9), st.integers(4, 7)),
        elements=st.floats(-(2.0**100), 2.0**100, width=32, allow_subnormal=True),
    ),
    encoding=st.integers(0, 3),
)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_finite_cloud_comes_back(tmp_path: Path, suffix: str, points: np.ndarray, encoding: int) -> None:
    variants = [variant for name, variant in FILES if name == f"a{suffix}"]
    columns = ("x", "y", "z", "intensity", "ring", "t", "f")[: points.shape[1]]
    path = tmp_path / f"any{suffix}"
    write_points(path, torch.from_numpy(points), encoding=variants[encoding % len(variants)], columns=columns)
    found = read_points(path)
    assert found.columns == columns
    assert torch.equal(found.points.view(torch.int32), torch.from_numpy(points).view(torch.int32))  # also -0.0


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz"])
@given(data=st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whole_number_fields_come_back_in_their_dtype(tmp_path: Path, suffix: str, data: st.DataObject) -> None:
    codes = ["u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8"]
    dtypes = [np.dtype("<" + data.draw(st.sampled_from(codes))) for _ in range(3)]
    rows = data.draw(st.integers(0, 5))
    arrays = [
        data.draw(hnp.arrays(dtype, rows, elements=None if dtype.kind in "iu" else st.floats(-9, 9, width=32)))
        for dtype in dtypes
    ]
    names = (*XYZI, "ring", "t")
    kinds = ["<f4", "<f4", "<f4", *(dtype.str for dtype in dtypes)]
    table = np.concatenate([np.ones((rows, 3)), np.stack(arrays, 1).astype(np.float64)], 1)
    fields = tuple(PointField(name, kind) for name, kind in zip(names, kinds, strict=True))
    format, variants = suffix[1:], [variant for name, variant in FILES if name == f"a{suffix}"]
    encoding = "columns" if format == "npz" else data.draw(st.sampled_from(variants))
    cloud = PointCloud(torch.from_numpy(table), names, layout=PointLayout(format, fields, str(encoding)))
    path = tmp_path / f"any{suffix}"
    write_points(path, cloud)
    found = read_points(path)
    assert found.layout is not None
    assert [np.dtype(one.dtype).str[1:] for one in found.layout.fields] == [np.dtype(kind).str[1:] for kind in kinds]
    assert torch.equal(found.points.double(), torch.from_numpy(table))


def test_time_stamps_make_the_cloud_float64_and_small_numbers_do_not(tmp_path: Path) -> None:
    x = np.arange(3, dtype=np.float32)
    stamps = np.array([0, 2**24 + 1, 2**32 - 1], np.uint32)
    np.savez(tmp_path / "t.npz", x=x, y=x, z=x, intensity=x, t=stamps)
    found = read_points(tmp_path / "t.npz")
    assert found.points.dtype == torch.float64
    assert found.column("t").tolist() == stamps.tolist()
    assert read_points(tmp_path / "t.npz", columns=XYZI).points.dtype == torch.float32
    assert read_points(tmp_path / "t.npz", dtype=torch.float32).points.dtype == torch.float32
    np.savez(tmp_path / "t.npz", x=x, y=x, z=x, intensity=x, t=np.array([1, 2, 2**24], np.uint32))
    assert read_points(tmp_path / "t.npz").points.dtype == torch.float32


def test_numbers_beyond_float64_are_refused_by_name(tmp_path: Path) -> None:
    x = np.ones(2, np.float32)
    np.savez(tmp_path / "t.npz", x=x, y=x, z=x, intensity=x, stamp=np.array([1, 2**53 + 1], np.uint64))
    with pytest.raises(TorchweatherError, match=r"column 'stamp' \(uint64, 1..9007199254740993\).*columns="):
        read_points(tmp_path / "t.npz")
    assert read_points(tmp_path / "t.npz", columns=XYZI).points.shape == (2, 4)


@pytest.mark.parametrize("name", INTENSITY_NAMES)
def test_the_intensity_is_found_under_its_names(tmp_path: Path, name: str) -> None:
    x = np.arange(2, dtype=np.float32)
    np.savez(tmp_path / "t.npz", **{"t": x, name.upper(): x + 7, "z": x, "y": x, "x": x})
    found = read_points(tmp_path / "t.npz")
    assert found.columns == ("x", "y", "z", name.upper(), "t")
    assert found.points[:, 3].tolist() == [7, 8]


def test_a_cloud_without_intensity_says_what_there_is(tmp_path: Path) -> None:
    x = np.ones(2, np.float32)
    np.savez(tmp_path / "t.npz", x=x, y=x, z=x, power=x * 3)
    with pytest.raises(TorchweatherError, match=r"named intensity, .*; got x, y, z, power\. .*intensity='none'"):
        read_points(tmp_path / "t.npz")
    assert read_points(tmp_path / "t.npz", intensity="power").points[0, 3] == 3
    assert read_points(tmp_path / "t.npz", intensity="none").columns == ("x", "y", "z", "power")
    with pytest.raises(TorchweatherError, match="Did you mean 'power'"):
        read_points(tmp_path / "t.npz", intensity="powr")
    with pytest.raises(TorchweatherError, match="There is no rng"):
        read_points(tmp_path / "t.npz", columns=("x", "y", "z", "rng"))
    np.savez(tmp_path / "t.npz", a=x, b=x)
    with pytest.raises(TorchweatherError, match="expected numbers as points"):
        read_points(tmp_path / "t.npz")


def test_a_fraction_in_a_whole_number_field_is_refused(tmp_path: Path) -> None:
    x = np.ones(2, np.float32)
    np.savez(tmp_path / "t.npz", x=x, y=x, z=x, intensity=np.array([3, 255], np.uint8))
    found = read_points(tmp_path / "t.npz")
    for value in (12.5, 256.0, -1.0):
        changed = found.points.clone()
        changed[0, 3] = value
        with pytest.raises(TorchweatherError, match="field 'intensity' is uint8"):
            write_points(tmp_path / "u.npz", found.with_points(changed))
    assert not (tmp_path / "u.npz").exists()
    write_points(tmp_path / "u.npz", replace(found.with_points(changed), layout=None))
    assert read_points(tmp_path / "u.npz").points[0, 3] == -1


def test_fewer_points_after_weather_are_written_without_the_grid(tmp_path: Path) -> None:
    write_points(tmp_path / "a.pcd", PointCloud(cloud_like("a"), XYZI, grid=(5, 10)))
    found = read_points(tmp_path / "a.pcd")
    assert found.grid == (5, 10)
    write_points(tmp_path / "b.pcd", found.with_points(found.points[:7]))
    fewer = read_points(tmp_path / "b.pcd")
    assert fewer.grid is None
    assert torch.equal(fewer.points, found.points[:7])


@pytest.mark.parametrize("source", ["a.pcd", "a.ply", "a.npz", "a.csv"])
@pytest.mark.parametrize("target", ["b.pcd", "b.ply", "b.npz", "b.csv", "b.bin"])
def test_any_format_turns_into_any_other(tmp_path: Path, source: str, target: str) -> None:
    write_points(tmp_path / source, cloud_like(source), encoding=None)
    found = read_points(tmp_path / source)
    write_points(tmp_path / target, found)
    assert torch.equal(read_points(tmp_path / target).points, found.points)


def test_dtypes_survive_a_change_of_format(tmp_path: Path) -> None:
    x = np.ones(2, np.float32)
    np.savez(tmp_path / "a.npz", x=x, y=x, z=x, intensity=np.array([3, 255], np.uint8), h=x.astype(np.float16))
    for name in ("b.pcd", "b.ply"):
        write_points(tmp_path / name, read_points(tmp_path / "a.npz"))
        layout = read_points(tmp_path / name).layout
        assert layout is not None
        assert [np.dtype(one.dtype).str[1:] for one in layout.fields] == ["f4", "f4", "f4", "u1", "f4"]


def test_five_columns_do_not_fit_kitti_until_four_are_chosen(tmp_path: Path) -> None:
    write_points(tmp_path / "a.pcd.bin", cloud_like("a.pcd.bin"))
    found = read_points(tmp_path / "a.pcd.bin")
    with pytest.raises(TorchweatherError, match="kitti holds 4 columns"):
        write_points(tmp_path / "a.bin", found)
    write_points(tmp_path / "a.bin", found, columns=XYZI)
    assert torch.equal(read_points(tmp_path / "a.bin").points, found.points[:, :4])


def test_the_suffix_tells_the_format_and_format_overrules_it(tmp_path: Path) -> None:
    assert next(iter(POINT_SUFFIXES)) == ".pcd.bin"
    write_points(tmp_path / "a.dat", cloud_like("a"), format="ply")
    assert (tmp_path / "a.dat").read_bytes().startswith(b"ply\n")
    assert read_points(tmp_path / "a.dat", format="ply").points.shape == (50, 4)
    with pytest.raises(ValueError, match=r"must end in .*\.laz; got 'a\.dat'"):
        read_points(tmp_path / "a.dat")
    with pytest.raises(ValueError, match="format must be one of"):
        read_points(tmp_path / "a.dat", format="xyz")
    with pytest.raises(ValueError, match="encoding must be one of"):
        write_points(tmp_path / "a.pcd", cloud_like("a"), encoding="zip")
    with pytest.raises(ValueError, match="encoding must be None for kitti"):
        write_points(tmp_path / "a.bin", cloud_like("a"), encoding="binary")
    write_points(tmp_path / "five.bin", cloud_like("a.pcd.bin", 7), format="nuscenes")
    with pytest.raises(TorchweatherError, match=r"Rows of nuscenes would fit \(format='nuscenes'\)"):
        read_points(tmp_path / "five.bin")


@pytest.mark.parametrize("name", ["a.bin", "a.pcd", "a.ply", "a.npz", "a.csv"])
def test_a_missing_file_and_a_missing_folder_are_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(TorchweatherError, match=name):
        read_points(tmp_path / name)
    with pytest.raises(TorchweatherError, match=name):
        write_points(tmp_path / "none" / name, cloud_like(name))
    (tmp_path / name).mkdir()
    with pytest.raises(TorchweatherError, match=name):
        read_points(tmp_path / name)


def test_a_batch_or_wrong_columns_are_refused(tmp_path: Path) -> None:
    for points in (torch.zeros(2, 5, 4), torch.zeros(5, 3), torch.zeros(5, 6)):
        with pytest.raises(ValueError, match=r"must be \(N, 4\) or \(N, 5\)"):
            write_points(tmp_path / "a.pcd", points)
    with pytest.raises(ValueError, match="columns must be"):
        write_points(tmp_path / "a.pcd", torch.zeros(5, 4), columns=("x", "y", "z"))
    with pytest.raises(ValueError, match="floating point"):
        PointCloud(torch.zeros(5, 4, dtype=torch.int32), XYZI)
    with pytest.raises(ValueError, match="grid"):
        PointCloud(torch.zeros(5, 4), XYZI, grid=(2, 3))
    with pytest.raises(ValueError, match="missing"):
        PointCloud(torch.zeros(5, 4), XYZI, missing=torch.zeros(5, dtype=torch.bool))
    with pytest.raises(ValueError, match="Did you mean 'intensity'"):
        PointCloud(torch.zeros(5, 4), XYZI).column("intensty")


@pytest.mark.parametrize("name", ["a.bin", "a.pcd", "a.ply", "a.npz"])
def test_a_million_points_take_a_fraction_of_a_second(tmp_path: Path, name: str) -> None:
    points = torch.rand(1_000_000, 4)
    start = time.perf_counter()
    write_points(tmp_path / name, points)
    assert torch.equal(read_points(tmp_path / name).points, points)
    # Measured 0.05 to 0.2 s; a loop over points in Python would take ten times the limit.
    assert time.perf_counter() - start < 2.0


@pytest.mark.real_data
@pytest.mark.parametrize(
    "name",
    [
        "kitti_nuscenes_demo/kitti/000008.bin",
        "kitti_nuscenes_demo/nuscenes/*.pcd.bin",
        "wads_snow/velodyne/042223.bin",
        "wads_snow/velodyne/042224.bin",
        "wads_snow/velodyne/042250.bin",
        *(f"radiate_fog/velo_lidar/0000{number}.csv" for number in ("01", "15", "30", "45")),
    ],
)
def test_real_clouds_are_written_back_byte_for_byte(
    real_data: Callable[[str], Path], tmp_path: Path, name: str
) -> None:
    source = real_data(name)
    found = read_points(source)
    assert found.points.dtype == torch.float32
    assert len(found.points) > 15_000
    target = tmp_path / source.name
    write_points(target, found)
    assert target.read_bytes() == source.read_bytes()


@pytest.mark.parametrize(
    ("unit", "taken"),
    [
        ("uint8_calibrated", "reflectivity"),
        ("reflectivity_percent", "reflectivity"),
        ("reflectivity", "reflectivity"),
        ("photons", "intensity"),
        ("uint8_linear", "intensity"),
    ],
)
def test_of_two_intensities_the_one_of_the_sensors_unit_is_taken(tmp_path: Path, unit: str, taken: str) -> None:
    names = ("x", "y", "z", "intensity", "t", "reflectivity", "ring")
    write_points(tmp_path / "a.pcd", torch.tensor([[20.0, 0, 0, 220, 0, 20, 3]]), columns=names)
    found = read_points(tmp_path / "a.pcd", intensity_unit=unit)
    assert found.columns[3] == taken
    assert found.points[0, 3] == (20 if taken == "reflectivity" else 220)
    write_points(tmp_path / "b.pcd", found)
    assert (tmp_path / "b.pcd").read_bytes() == (tmp_path / "a.pcd").read_bytes()


def test_of_two_intensities_and_no_unit_the_choice_is_warned_of(tmp_path: Path) -> None:
    names = ("x", "y", "z", "intensity", "reflectivity")
    write_points(tmp_path / "a.pcd", torch.tensor([[20.0, 0, 0, 220, 20]]), columns=names)
    with pytest.warns(TorchweatherWarning, match="intensity and reflectivity; intensity is taken"):
        assert read_points(tmp_path / "a.pcd").columns[3] == "intensity"
    assert read_points(tmp_path / "a.pcd", intensity="reflectivity").columns[3] == "reflectivity"  # no warning
