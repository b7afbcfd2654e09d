"""Radar power maps from files and back: polar pictures with and without metadata, arrays with axes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from torchweather.core.errors import TorchweatherError
from torchweather.io import MapLayout, MapRecord, map_layout, read_power_map, write_image, write_power_map
from torchweather.radar.power_map import MapAxes, PowerScale, RadarPowerMap

AZIMUTHS, BINS = 400, 64


def picture(rows: int, columns: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (rows, columns), generator=generator, dtype=torch.uint8)


def metadata(interpolated: tuple[int, ...] = (7,), start: int = 100) -> np.ndarray:
    """The first eleven columns as Oxford's development kit reads them: int64 time, uint16 encoder, flag."""
    header = np.zeros((AZIMUTHS, 11), np.uint8)
    times = (1_547_131_046_353_776 + 625 * np.arange(AZIMUTHS)).astype("<i8")
    ticks = ((start + 14 * np.arange(AZIMUTHS)) % 5600).astype("<u2")
    header[:, :8] = times[:, None].view(np.uint8)
    header[:, 8:10] = ticks[:, None].view(np.uint8)
    header[:, 10] = 255
    header[list(interpolated), 10] = 0
    return header


def oxford(path: Path, **more: Any) -> Tensor:
    power = picture(AZIMUTHS, BINS)
    Image.fromarray(np.concatenate([metadata(**more), power.numpy()], 1)).save(path, compress_level=1)
    return power


# ---- pictures ------------------------------------------------------------------------------------------------------


def test_a_bare_picture_of_radiate(tmp_path: Path) -> None:
    power = picture(BINS, AZIMUTHS)
    write_image(tmp_path / "a.png", power[None])
    found = read_power_map(tmp_path / "a.png", "radiate")
    assert torch.equal(found.values, power)
    assert found.axes.dims == ("range", "azimuth")
    assert found.axes.full_turn
    assert found.range_bin_m == pytest.approx(0.17361)
    assert found.axes.range_m[0] == pytest.approx(0.0868, abs=1e-4)
    # Clockwise: a quarter of a turn on it looks to the right, which is negative.
    assert found.axes.azimuth_rad is not None
    assert found.axes.azimuth_rad[100] == pytest.approx(-math.pi / 2)
    assert found.scale == PowerScale.steps(0.5)
    assert found.notes == ("azimuths: a full turn, clockwise from forward",)


def test_a_picture_of_oxford_has_times_azimuths_and_flags(tmp_path: Path) -> None:
    power = oxford(tmp_path / "a.png")
    found = read_power_map(tmp_path / "a.png", "oxford")
    assert torch.equal(found.values, power)
    assert found.axes.dims == ("azimuth", "range")
    assert found.axes.azimuth_rad is not None
    assert found.axes.azimuth_rad[0] == pytest.approx(-2.0 * math.pi * 100 / 5600)
    assert found.axes.azimuth_bin_rad == pytest.approx(2.0 * math.pi / 400)
    assert found.axes.full_turn
    record = found.record
    assert isinstance(record, MapRecord)
    assert record.timestamps is not None
    assert record.timestamps[:2].tolist() == [1_547_131_046_353_776, 1_547_131_046_354_401]
    assert record.measured is not None
    assert (~record.measured).nonzero().flatten().tolist() == [7]
    assert "1 of 400 rows were interpolated" in found.notes[1]


@pytest.mark.parametrize("kind", ["bare", "oxford"])
def test_a_picture_that_did_not_change_is_the_same_file_and_one_that_did_keeps_its_header(
    tmp_path: Path, kind: str
) -> None:
    source = tmp_path / "a.png"
    if kind == "oxford":
        oxford(source)
    else:
        # Another compression than the writer's own.
        Image.fromarray(picture(BINS, AZIMUTHS).numpy()).save(source, compress_level=1)
    found = read_power_map(source, "oxford" if kind == "oxford" else "radiate")
    write_power_map(tmp_path / "same.png", found.with_values(found.values.clone()))
    assert (tmp_path / "same.png").read_bytes() == source.read_bytes()
    changed = 255 - found.values
    write_power_map(tmp_path / "other.png", found.with_values(changed))
    again = read_power_map(tmp_path / "other.png", "oxford" if kind == "oxford" else "radiate")
    assert torch.equal(again.values, changed)
    assert again.axes == found.axes
    if kind == "oxford":
        assert isinstance(again.record, MapRecord)
        assert torch.equal(again.record.header, found.record.header)  # type: ignore[arg-type]


def test_a_picture_whose_first_columns_are_power_is_not_taken_for_one_with_metadata(tmp_path: Path) -> None:
    power = picture(AZIMUTHS, BINS)
    write_image(tmp_path / "a.png", power[None])
    found = read_power_map(tmp_path / "a.png", "mulran")
    assert found.axes.shape == (AZIMUTHS, BINS)
    assert torch.equal(found.values, power)
    header = metadata()
    header[5, 10] = 3  # no flag
    Image.fromarray(np.concatenate([header, power.numpy()], 1)).save(tmp_path / "b.png")
    assert read_power_map(tmp_path / "b.png", "mulran").axes.shape == (AZIMUTHS, BINS + 11)


@pytest.mark.parametrize(
    ("make", "layout", "said"),
    [
        (lambda p: write_image(p, picture(BINS, AZIMUTHS)[None]), None, "width of a range bin.*layout='radiate'"),
        (lambda p: write_image(p, picture(40, 50)[None]), "oxford", "which side of 40 x 50 is the azimuth"),
        (lambda p: write_image(p, torch.zeros(3, 8, 400, dtype=torch.uint8)), "oxford", "grey picture of 8 bits"),
        (lambda p: write_image(p, torch.zeros(1, 8, 400, dtype=torch.uint16)), "oxford", "got torch.uint16"),
        (lambda p: p.write_bytes(b"no picture"), "oxford", "content is none of them"),
        (lambda p: oxford(p), MapLayout(("range", "azimuth"), {"first": 1, "step": 1}), r"dims are \[azimuth, range\]"),
        (lambda p: None, "radiate", "no such file"),
    ],
)
def test_pictures_that_hold_no_map_are_refused(tmp_path: Path, make: Any, layout: Any, said: str) -> None:
    make(tmp_path / "a.png")
    with pytest.raises(TorchweatherError, match=said):
        read_power_map(tmp_path / "a.png", layout)


# ---- arrays --------------------------------------------------------------------------------------------------------


def layout_file(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


RANGES = "range_m: {first: 0.5, step: 1.0}\n"


def test_an_array_of_complex_quadratures(tmp_path: Path) -> None:
    numbers = np.random.default_rng(0).normal(size=(16, 12, 2)).astype("<f4")
    np.save(tmp_path / "a.npy", numbers)
    text = f"dims: [range, azimuth]\n{RANGES}azimuth_deg: {{first: 55, step: -10}}\nquadratures: true\n"
    found = read_power_map(tmp_path / "a.npy", layout_file(tmp_path / "cruw.yaml", text))
    assert found.values.dtype == torch.complex64
    assert found.scale.kind == "complex"
    assert found.decibels[0, 0] == pytest.approx(10.0 * np.log10(np.square(numbers[0, 0]).sum()), abs=1e-4)
    assert found.axes.azimuth_rad is not None
    assert found.axes.azimuth_rad[0] == pytest.approx(math.radians(55))
    write_power_map(tmp_path / "same.npy", found)
    assert (tmp_path / "same.npy").read_bytes() == (tmp_path / "a.npy").read_bytes()
    write_power_map(tmp_path / "twice.npy", found.with_values(2.0 * found.values))
    assert np.array_equal(np.load(tmp_path / "twice.npy"), 2.0 * numbers)


def test_a_tensor_of_four_dimensions(tmp_path: Path) -> None:
    numbers = np.random.default_rng(0).exponential(size=(8, 6, 3, 5)).astype(np.float32)
    np.save(tmp_path / "a.npy", numbers)
    text = (
        f"dims: [doppler, range, elevation, azimuth]\nscale: linear\n{RANGES}azimuth_deg: [40, 20, 0, -20, -40]\n"
        "elevation_deg: [-10, 0, 10]\nspeed_m_per_s: {first: -2, step: 0.5}\n"
    )
    found = read_power_map(tmp_path / "a.npy", layout_file(tmp_path / "radar.yaml", text))
    assert found.axes.shape == (8, 6, 3, 5)
    assert found.axes.speed_m_per_s == tuple(-2.0 + 0.5 * k for k in range(8))
    assert torch.equal(found.values, torch.from_numpy(numbers))


@pytest.mark.parametrize("compressed", [False, True])
def test_an_archive_with_axes_of_its_own(tmp_path: Path, compressed: bool) -> None:
    numbers = np.random.default_rng(0).normal(size=(4, 5))
    save = np.savez_compressed if compressed else np.savez
    save(
        tmp_path / "a.npz", map=numbers, dims=["range", "azimuth"], scale="db", range_m=np.arange(1.0, 5.0),
        azimuth_rad=np.linspace(-0.5, 0.5, 5), track=np.arange(3),
    )  # fmt: skip
    found = read_power_map(tmp_path / "a.npz")
    assert found.axes.azimuth_rad == pytest.approx(tuple(np.linspace(-0.5, 0.5, 5)))
    assert found.values.dtype == torch.float64
    write_power_map(tmp_path / "same.npz", found)
    assert (tmp_path / "same.npz").read_bytes() == (tmp_path / "a.npz").read_bytes()
    write_power_map(tmp_path / "b.npz", found.with_values(found.values + 1.0))
    with np.load(tmp_path / "b.npz") as arrays:
        assert np.array_equal(arrays["map"], numbers + 1.0)
        assert np.array_equal(arrays["track"], np.arange(3))
    assert read_power_map(tmp_path / "b.npz").axes == found.axes


def test_a_map_of_no_file_is_written_with_its_axes(tmp_path: Path) -> None:
    axes = MapAxes(("range", "azimuth"), (1.0, 2.0, 3.0), (0.1, -0.1))
    power_map = RadarPowerMap(torch.rand(3, 2), axes, PowerScale("amplitude"))
    write_power_map(tmp_path / "a.npz", power_map)
    again = read_power_map(tmp_path / "a.npz")
    assert torch.equal(again.values, power_map.values)
    assert again.scale == power_map.scale
    assert again.axes.azimuth_rad == pytest.approx(axes.azimuth_rad)
    with pytest.raises(TorchweatherError, match="holds bytes over range and azimuth"):
        write_power_map(tmp_path / "a.png", power_map)


@pytest.mark.parametrize(
    ("array", "text", "said"),
    [
        (np.ones((4, 5), np.float32), "scale: db\n", "names of 2 dimensions, sizes 4 x 5; got none"),
        (np.ones((4, 5), np.float32), f"dims: [range, azimuth]\nscale: db\n{RANGES}", "5 cells of azimuth have no"),
        (
            np.ones((4,), np.float32),
            f"dims: [range]\n{RANGES}",
            "expected a scale; the file does not state if its numbers are",
        ),
        (np.ones((4,), np.float32), "dims: [range]\nscale: db\nrange_m: [1, 2]\n", "expected 4 values of range_m"),
        (np.ones((4,), np.float32), "dims: [range]\nscale: db\nrange_m: {first: 1}\n", "first and step"),
        (np.ones((4,), np.float32), "dims: [distance]\nscale: db\n", "dims must be one of range"),
        (np.ones((4,), np.float32), "dim: [range]\n", "unknown key 'dim'; known are dims.*Did you mean 'dims'"),
        (np.ones((4,), np.float32), "- range\n", "it must be keys with values: dims"),
        (np.ones((4, 3), np.float32), f"dims: [range]\nquadratures: true\n{RANGES}", "a last dimension of 2"),
        (-np.ones((4,), np.float32), f"dims: [range]\nscale: linear\n{RANGES}", "0 or more; got -1"),
        (np.ones((4,), np.float32), f"dims: [range]\nscale: complex\n{RANGES}", "does not fit numbers"),
    ],
)
def test_arrays_without_axes_or_scale_are_refused(tmp_path: Path, array: Any, text: str, said: str) -> None:
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(TorchweatherError, match=said):
        read_power_map(tmp_path / "a.npy", layout_file(tmp_path / "layout.yaml", text))


def test_layouts_have_names() -> None:
    assert map_layout("boreas-2021").range_m == {"first": 0.5 * 0.04381, "step": 0.04381}
    with pytest.raises(ValueError, match="must be one of radiate, oxford, mulran"):
        map_layout("radiat")
    with pytest.raises(TorchweatherError, match="no such file"):
        map_layout("none.yaml")


def test_an_archive_with_several_arrays_asks_for_the_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", left=np.ones(3), right=np.ones(3))
    with pytest.raises(TorchweatherError, match=r"named map or power or values; got left, right. Give key"):
        read_power_map(tmp_path / "a.npz")
    layout = MapLayout(("range",), (1.0, 2.0, 3.0), scale="linear", key="right")
    assert read_power_map(tmp_path / "a.npz", layout).axes.shape == (3,)
    with pytest.raises(TorchweatherError, match=r"expected a radar power map: .png, .npy or .npz; got .tif"):
        read_power_map(tmp_path / "a.tif", layout)
