"""Disdrometer readers: counting drops back into the air they fell from, and three real formats."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.io import netcdf_file

from torchweather.core.errors import TorchweatherError
from torchweather.io import (
    DropSpectrum,
    parsivel_area_mm2,
    parsivel_edges_mm,
    parsivel_speeds_m_per_s,
    read_disdrometer,
    spectrum_from_counts,
    spectrum_from_drops,
)
from torchweather.physics import Binned, marshall_palmer, rain_fall_speed_m_per_s, rain_rate_mm_per_h


def expected_counts(rate_mm_per_h: float, duration_s: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean counts ``(K, V)`` of a Parsivel in Marshall-Palmer rain, each drop at the class nearest to its speed."""
    edges, speeds = parsivel_edges_mm(), parsivel_speeds_m_per_s()
    diameter = 0.5 * (edges[1:] + edges[:-1])
    law = rain_fall_speed_m_per_s(diameter)
    density = 8000.0 * torch.exp(-4.1 * rate_mm_per_h**-0.21 * diameter)
    number = density * edges.diff() * law * duration_s * parsivel_area_mm2(edges) * 1e-6
    number = torch.where((diameter > 0.25) & (diameter < 6), number, 0.0)
    nearest = (speeds[None] - law[:, None]).abs().argmin(1)
    return torch.zeros(32, 32, dtype=torch.float64).index_put((torch.arange(32), nearest), number), density


def spectrum(counts: torch.Tensor, **more: object) -> DropSpectrum:
    return spectrum_from_counts(
        counts,
        parsivel_edges_mm(),
        parsivel_speeds_m_per_s(),
        duration_s=60.0,
        area_mm2=parsivel_area_mm2(parsivel_edges_mm()),
        time_s=torch.zeros(len(counts)),
        instrument="synthetic",
        **more,  # type: ignore[arg-type]
    )


def test_counts_of_known_rain_give_its_density_and_rate_back() -> None:
    counts, density = expected_counts(10.0, 60.0)
    found = spectrum(counts[None])
    seen = counts.sum(1) > 0
    # The nearest speed class is off by up to half its width: 0.1 of 1.2 m/s.
    torch.testing.assert_close(found.density_per_m3_mm[0][seen], density[seen], rtol=0.09, atol=0)
    exact = rain_rate_mm_per_h(marshall_palmer(10.0, diameter_min_mm=0.25))
    # Class centres stand for classes up to 0.5 mm wide, over which D^3 and the density both bend.
    assert found.rate_mm_per_h.item() == pytest.approx(float(exact), rel=0.03)


def test_binned_distribution_of_the_spectrum_carries_the_counted_rate() -> None:
    counts, _ = expected_counts(25.0, 60.0)
    found = spectrum(counts[None])
    rate = rain_rate_mm_per_h(Binned(found.edges_mm, found.density_per_m3_mm))
    torch.testing.assert_close(rate, found.rate_mm_per_h, rtol=0.05, atol=0)  # speeds by class and by law


def test_drops_at_the_wrong_speed_are_left_out() -> None:
    counts = torch.zeros(1, 32, 32)
    counts[0, 12, 20] = 7  # 1.9 mm at 4.4 m/s: 6.1 m/s less 28 %
    counts[0, 12, 31] = 100  # the same size at 20.8 m/s
    counts[0, 12, 0] = 100  # splash
    found = spectrum(counts)
    kept = spectrum(counts, fall_speed_tolerance=math.inf)
    assert found.rate_mm_per_h.item() == pytest.approx(kept.rate_mm_per_h.item() * 7 / 207)


def test_longer_measurement_of_the_same_counts_means_thinner_rain() -> None:
    counts, _ = expected_counts(10.0, 60.0)
    arguments = (counts[None], parsivel_edges_mm(), parsivel_speeds_m_per_s())
    area = parsivel_area_mm2(parsivel_edges_mm())
    one, two = (
        spectrum_from_counts(*arguments, duration_s=t, area_mm2=area, time_s=torch.zeros(1), instrument="x")
        for t in (60.0, 120.0)
    )
    torch.testing.assert_close(two.density_per_m3_mm, one.density_per_m3_mm / 2)
    torch.testing.assert_close(two.rate_mm_per_h, one.rate_mm_per_h / 2)


def test_parsivel_classes_end_at_26_mm_and_22_m_per_s() -> None:
    assert parsivel_edges_mm()[-1] == 26.0
    assert parsivel_speeds_m_per_s()[-1].item() == pytest.approx(22.4 - 1.6)
    # Drops of 1 mm: 180 mm x (30 - 0.5) mm.
    assert parsivel_area_mm2(torch.tensor([0.5, 1.5])).item() == pytest.approx(180 * 29.5)


def test_one_drop_stands_for_the_column_of_air_it_crossed() -> None:
    speed = float(rain_fall_speed_m_per_s(2.0))
    found = spectrum_from_drops(
        torch.tensor([2.0]), torch.tensor([speed]), torch.tensor([10000.0]), torch.tensor([30.0]),
        edges_mm=torch.tensor([0.9, 1.9, 2.1]), duration_s=60.0, instrument="x",
    )  # fmt: skip
    assert found.density_per_m3_mm.shape == (1, 2)
    assert found.density_per_m3_mm[0].tolist() == pytest.approx([0.0, 1 / (0.01 * 60 * speed * 0.2)], rel=1e-6)
    # (pi/6) 8 mm^3 over 0.01 m^2 in a minute
    assert found.rate_mm_per_h.item() == pytest.approx(math.pi / 6 * 8 / (0.01 * 1e6) * 60, rel=1e-6)


def test_drops_fall_into_their_intervals() -> None:
    time = torch.tensor([5.0, 61.0, 62.0, 200.0])
    ones = torch.ones(4)
    found = spectrum_from_drops(
        ones, ones * 4.0, ones * 10000, time, edges_mm=torch.tensor([0.5, 1.5]), duration_s=60.0, instrument="x"
    )
    assert found.time_s.tolist() == [60.0, 120.0, 180.0, 240.0]
    torch.testing.assert_close(found.rate_mm_per_h / found.rate_mm_per_h[0], torch.tensor([1.0, 2, 0, 1]).double())


def test_mean_of_chosen_intervals() -> None:
    counts, _ = expected_counts(10.0, 60.0)
    found = spectrum(torch.stack([counts, 3 * counts, 100 * counts]), reported_mor_m=torch.tensor([1000.0, 500.0, 1.0]))
    mean = found.chosen(torch.tensor([True, True, False])).mean()
    torch.testing.assert_close(mean.rate_mm_per_h, 2 * found.rate_mm_per_h[:1])
    assert mean.duration_s == 120.0
    assert mean.reported_mor_m is not None
    assert mean.reported_mor_m.item() == pytest.approx(1 / (0.5 * (1 / 1000 + 1 / 500)))
    with pytest.raises(ValueError, match="no interval"):
        found.chosen(found.rate_mm_per_h > 1e9).mean()


def telegram(counts_by_speed: torch.Tensor, second: int) -> str:
    spectrum = ",".join(f"{int(n):03d}" for n in counts_by_speed.flatten())
    head = f'1,4610.3,00847.2,"29-10-2018 01:00:{second:02d}","na","OK","0012.500","0165.80","61","61","13.8","1278"'
    empty = '"' + "-9.999," * 32 + '"'
    return f'{head},"0","0","0","0","0","0","0","0",{empty},{empty},"{spectrum},","x"\r\n'


@pytest.mark.parametrize("packed", [False, True])
def test_telegrams_run_through_the_diameters_of_each_speed(tmp_path: Path, packed: bool) -> None:
    counts = torch.zeros(32, 32)
    counts[20, 11] = 9  # speed class 20: 4.4 m/s; diameter class 11: 1.625 mm
    text = (telegram(counts, 0) + telegram(counts * 2, 30)).encode()
    path = tmp_path / ("x.dat.gz" if packed else "x.dat")
    path.write_bytes(gzip.compress(text) if packed else text)
    found = read_disdrometer(path)
    assert found.duration_s == 30.0
    assert found.density_per_m3_mm.nonzero().tolist() == [[0, 11], [1, 11]]
    volume_m3 = 180e-3 * (30 - 1.625 / 2) * 1e-3 * 30 * 4.4
    assert found.density_per_m3_mm[0, 11].item() == pytest.approx(9 / (volume_m3 * 0.25))
    assert found.time_s.diff().item() == 30.0
    assert found.time_s[0].item() == np.datetime64("2018-10-29T01:00:00", "s").astype(float)
    assert found.reported_rate_mm_per_h is not None
    assert found.reported_rate_mm_per_h.tolist() == [12.5, 12.5]
    assert found.reported_mor_m is not None
    assert found.reported_mor_m.tolist() == [1278.0, 1278.0]


def write_video_file(path: Path, without: str = "") -> None:
    values = {
        "equivolumetric_sphere_diameter": [1.0, 2.0, -9999.0],
        "fall_speed": [4.0, 6.5, 4.0],
        "area": [10000.0, 10000.0, 10000.0],
        "time_offset": [1.0, 61.0, 62.0],
    }
    with netcdf_file(path, "w") as file:
        file.createDimension("time", 3)
        for name, numbers in values.items():
            if name != without:
                file.createVariable(name, "d", ("time",))[:] = numbers
        base = file.createVariable("base_time", "i", ())
        base.data[...] = 1200


def test_video_file_is_sorted_into_minutes_without_missing_values(tmp_path: Path) -> None:
    write_video_file(tmp_path / "x.cdf")
    found = read_disdrometer(tmp_path / "x.cdf")
    assert found.time_s.tolist() == [1260.0, 1320.0]
    assert (found.density_per_m3_mm > 0).sum(1).tolist() == [1, 1]
    assert read_disdrometer(tmp_path / "x.cdf", duration_s=600.0).density_per_m3_mm.shape[0] == 1


def test_other_netcdf_and_truncated_files_are_named(tmp_path: Path) -> None:
    write_video_file(tmp_path / "x.cdf", without="area")
    with pytest.raises(TorchweatherError, match=r"x\.cdf.*area missing"):
        read_disdrometer(tmp_path / "x.cdf")
    write_video_file(tmp_path / "y.cdf")
    whole = (tmp_path / "y.cdf").read_bytes()
    (tmp_path / "y.cdf").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(TorchweatherError, match=r"y\.cdf.*truncated"):
        read_disdrometer(tmp_path / "y.cdf")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"a,b,c\n", "line 1 has 3 columns"),
        (telegram(torch.zeros(32, 31), 0).encode(), "992 classes"),
        (gzip.compress(telegram(torch.zeros(32, 32), 0).encode(), mtime=0)[:60], "truncated"),
        (bytes(range(128, 255)), "truncated or something else"),
        (telegram(torch.zeros(32, 32), 0).replace("29-10-2018", "yesterday").encode(), "something else"),
    ],
)
def test_broken_telegrams_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "x.dat").write_bytes(content)
    with pytest.raises(TorchweatherError, match=rf"x\.dat.*expected.*|{message}") as caught:
        read_disdrometer(tmp_path / "x.dat")
    assert message in str(caught.value)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match="cannot be read"):
        read_disdrometer(tmp_path / "none.nc")


def test_broken_hdf5_is_named_or_the_extra_is(tmp_path: Path) -> None:
    (tmp_path / "x.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(TorchweatherError, match=r"x\.nc.*(truncated or damaged|pip install torchweather\[io\])"):
        read_disdrometer(tmp_path / "x.nc")


@pytest.mark.parametrize("swapped", [False, True])
def test_netcdf_is_read_whichever_axis_is_called_diameter(tmp_path: Path, swapped: bool) -> None:
    pytest.importorskip("h5py", reason="the extra 'io' is not installed")
    h5netcdf = pytest.importorskip("h5netcdf")
    counts, _ = expected_counts(10.0, 60.0)
    stored = counts.round().int()
    edges = parsivel_edges_mm().numpy()
    speeds = np.append(0.0, np.cumsum([0.1] * 10 + [0.2] * 5 + [0.4] * 5 + [0.8] * 5 + [1.6] * 5 + [3.2] * 2))
    with h5netcdf.File(tmp_path / "x.nc", "w") as file:
        file.dimensions = {"time": 1, "d": 32, "v": 32}
        for name, dimension, values in [
            ("diameter_lower_bounds", "d", edges[:-1]),
            ("diameter_upper_bounds", "d", edges[1:]),
            ("velocity_lower_bounds", "v", speeds[:-1]),
            ("velocity_upper_bounds", "v", speeds[1:]),
        ]:
            file.create_variable(name, (dimension,), data=values)
        file.create_variable("time", ("time",), data=np.array([14.5])).attrs["units"] = (
            "hours since 2024-07-22 00:00:00"
        )
        file.create_variable("time_interval", (), data=np.int32(60))
        file.create_variable("data_raw", ("time", "d", "v"), data=(stored.mT if swapped else stored).numpy()[None])
    found = read_disdrometer(tmp_path / "x.nc")
    torch.testing.assert_close(found.rate_mm_per_h, spectrum(stored[None]).rate_mm_per_h)
    assert found.time_s.item() == np.datetime64("2024-07-22T14:30:00", "s").astype(float)


@pytest.mark.real_data
def test_real_telegrams_carry_the_rain_that_the_instrument_reported(real_data: Callable[[str], Path]) -> None:
    """Storm Vaia at Locarno: 166 mm reported; the spectra hold 4 % less (edge hits and splashes are left out)."""
    found = read_disdrometer(real_data("disdrometer/file61_20181029.dat.gz"))
    assert found.density_per_m3_mm.shape == (6526, 32)
    assert found.reported_rate_mm_per_h is not None
    total, reported = (float(r.sum()) * 30 / 3600 for r in (found.rate_mm_per_h, found.reported_rate_mm_per_h))
    assert reported == pytest.approx(166.1, abs=0.1)
    assert total == pytest.approx(reported, rel=0.06)


@pytest.mark.real_data
def test_real_video_disdrometer(real_data: Callable[[str], Path]) -> None:
    found = read_disdrometer(real_data("disdrometer/corvdisdropsM1*.cdf"))
    assert 1 < float(found.rate_mm_per_h.sum()) / 60 < 5  # a few mm in 19 hours
    by_law = rain_rate_mm_per_h(Binned(found.edges_mm, found.density_per_m3_mm))
    # Each drop's own speed and the law's differ by a few percent on average.
    assert float(by_law.sum() / found.rate_mm_per_h.sum()) == pytest.approx(1.0, abs=0.15)


@pytest.mark.real_data
@pytest.mark.parametrize("name", ["20240722_Green_Village*.nc", "L1.1MIN.HYMEX*20121026*.nc"])
def test_real_netcdf_spectra_fall_like_rain(real_data: Callable[[str], Path], name: str) -> None:
    pytest.importorskip("h5py", reason="the extra 'io' is not installed")
    path = real_data(f"disdrometer/{name}")
    found, unfiltered = read_disdrometer(path), read_disdrometer(path, fall_speed_tolerance=math.inf)
    assert found.duration_s == 60.0
    assert float(found.rate_mm_per_h.sum() / unfiltered.rate_mm_per_h.sum()) > 0.9
