"""Pattern and near-range response fitted to made recordings, and `torchweather fit-sensor` on files of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from tests.lidar.sweep.scan_sweep import COLUMNS, ELEVATIONS_DEG, HEIGHTS_M, sweep
from torchweather.cli import main
from torchweather.io import write_points
from torchweather.lidar import fit_near_response, fit_pattern
from torchweather.sensors import Lidar

K = 373_000.0


def recording(full_m: float, power: float, count: int = 10_000, seed: int = 0) -> tuple[Any, Any, Any]:
    """Photons, reflectivity and range of returns whose receiver has a response; photon noise."""
    rng = np.random.default_rng(seed)
    range_m = np.exp(rng.uniform(np.log(3.0), np.log(110.0), count))
    reflectivity = rng.uniform(0.05, 0.9, count)
    mean = K * reflectivity * np.minimum(1.0, range_m / full_m) ** power / range_m**2
    return rng.poisson(mean).astype(float), reflectivity, range_m


@pytest.mark.parametrize(("full_m", "power"), [(30.0, 2.0), (12.0, 1.0), (20.0, 3.0)])
def test_the_response_of_a_made_recording_is_found_within_its_intervals(full_m: float, power: float) -> None:
    fit = fit_near_response(*recording(full_m, power))
    # 95 percent intervals of three figures in three cases: three half-widths leave a chance of 1e-4 in all.
    for found, interval, true in (
        (fit.photon_constant, fit.photon_constant_interval, K),
        (fit.near_full_m, fit.near_full_interval_m, full_m),
        (fit.near_power, fit.near_power_interval, power),
    ):
        assert abs(found - true) < max(1.5 * interval, 0.03 * true)
        assert 0 < interval < 0.25 * true
    range_m = np.array([4.0, 10.0, 50.0])
    np.testing.assert_allclose(fit.xi(range_m), np.minimum(1, range_m / full_m) ** power, atol=0.03)


def test_a_response_becomes_that_of_the_sensor() -> None:
    fit = fit_near_response(*recording(30.0, 2.0))
    lidar = fit.applied_to(Lidar.preset("ouster-os2-128"))
    assert lidar.near_start_m == 0.0
    assert lidar.near_full_m == pytest.approx(fit.near_full_m, abs=0.01)
    assert lidar.photons_at_threshold == pytest.approx(
        0.1 * fit.photon_constant / lidar.range_at_10_percent_m**2, abs=0.01
    )
    at_ten = lidar.near_response(torch.tensor([10.0]))
    assert float(at_ten) == pytest.approx(1 / 9, rel=0.05)


def test_too_few_returns_and_values_of_another_length_are_refused() -> None:
    with pytest.raises(ValueError, match="one value a return each; got 3, 3 and 2"):
        fit_near_response([1.0, 2.0, 3.0], [0.1, 0.1, 0.1], [5.0, 6.0])
    signal, reflectivity, range_m = recording(30.0, 2.0, count=100)
    with pytest.raises(ValueError, match="fit_near_response"):
        fit_near_response(signal, reflectivity, range_m)


def test_several_sweeps_give_the_pattern_with_its_scatter() -> None:
    clouds = [torch.from_numpy(sweep(seed=seed)[0]) for seed in range(4)]
    fit = fit_pattern(clouds)
    assert fit.rings == len(ELEVATIONS_DEG)
    order = np.argsort(ELEVATIONS_DEG)
    np.testing.assert_allclose(fit.elevations_deg, ELEVATIONS_DEG[order], atol=0.01)
    np.testing.assert_allclose(fit.heights_m, HEIGHTS_M[order], atol=0.01)
    assert fit.columns == COLUMNS
    sensor = fit.applied_to(Lidar(905.0))
    assert sensor.columns == COLUMNS
    assert sensor.elevations_deg is not None
    np.testing.assert_allclose(sorted(sensor.elevations_deg), ELEVATIONS_DEG[order], atol=0.01)


def test_sweeps_of_two_sensors_are_refused() -> None:
    one = torch.from_numpy(sweep()[0])
    other = torch.from_numpy(sweep(elevations_deg=ELEVATIONS_DEG + 1.5)[0])
    with pytest.raises(ValueError, match="fit_pattern"):
        fit_pattern([one, other])


def test_the_command_writes_a_sensor_that_others_take(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in range(2):
        write_points(tmp_path / f"{seed}.bin", torch.from_numpy(sweep(seed=seed)[0]))
    files = [str(tmp_path / f"{seed}.bin") for seed in range(2)]
    out = tmp_path / "my.yaml"
    assert main(["fit-sensor", *files, "--out", str(out)]) == 2
    assert "--sensor lidar:PRESET is needed" in capsys.readouterr().err
    assert not out.exists()
    assert main(["fit-sensor", *files, "--sensor", "lidar:velodyne-hdl-64e", "--out", str(out), "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "2 sweeps, 24 rings" in said
    assert f"columns a turn: {COLUMNS}" in said
    assert (tmp_path / "my.png").read_bytes()[:4] == b"\x89PNG"
    written = yaml.safe_load(out.read_text(encoding="utf-8"))
    assert len(written["elevations_deg"]) == 24
    weather = ["--weather", "snow:rate=1", "--intensity-unit", "reflectivity", "--complete-scan", "--force"]
    assert main(["apply", files[0], "--sensor", f"lidar:{out}", *weather, "-o", str(tmp_path / "out")]) == 0
    assert "empty beams 2" in capsys.readouterr().out  # a tenth of 24 x 900 beams
