"""``torchweather apply`` on radar power maps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchweather.atmosphere.weather import Rain
from torchweather.io import read_power_map, write_image
from torchweather.radar.map_transform import RadarMapWeather
from torchweather.radar.power_map import with_noise_scale
from torchweather.sensors import Radar

SENSOR = ("--sensor", "radar:navtech-radiate")
RAIN = ("--weather", "rain:rate=50")


def frame(path: Path, seed: int = 0) -> Path:
    """Noise of 200 range bins as a recorder's bytes, and a wall."""
    uniform = torch.rand(200, 400, generator=torch.Generator().manual_seed(seed))
    power = -torch.log1p(-uniform)
    power[120:124, 50:90] = 1e5
    write_image(path, (20.0 + 20.0 * power.log10()).clamp(0, 255).round().to(torch.uint8)[None])
    return path


def test_maps_come_out_as_the_transform_gives_them_in_their_own_format(run: Any, tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    files = [frame(source / f"{k}.png", k) for k in range(2)]
    out = tmp_path / "out"
    code, text, err = run(
        "apply", "--json", source, *SENSOR, *RAIN, "-o", out, "--map", "radiate", "--seed", 5, "--labels", "npz"
    )
    assert code == 0, err
    entries = json.loads(text)["files"]
    assert [entry["seed"] for entry in entries] == [5, 6]
    assert "clockwise from forward" in err
    for number, (file, entry) in enumerate(zip(files, entries, strict=True)):
        clear = with_noise_scale(read_power_map(file, "radiate"))
        transform = RadarMapWeather(Rain(50), Radar.preset("navtech-radiate"), axes=clear.axes, scale=clear.scale)
        wet = read_power_map(out / file.name, "radiate")
        assert torch.equal(wet.values, transform.of_map(clear, seed=5 + number).values)
        assert entry["noise_law"] == "measured"
        assert abs(entry["noise_floor_db"]) < 0.2
        assert entry["dims"] == {"range": 200, "azimuth": 400}
        assert entry["attenuation_db"] == pytest.approx(2e-3 * entry["attenuation_db_per_km"] * 34.635, rel=1e-3)
        assert entry["detections_clear"] > 0
        with np.load(entry["labels"]) as labels:
            assert float(labels["attenuation_db"].max()) == pytest.approx(entry["attenuation_db"])
            assert float(labels["clutter_db"].max()) == pytest.approx(entry["clutter_db"])


def test_no_weather_gives_the_bytes_of_the_files(run: Any, tmp_path: Path) -> None:
    file = frame(tmp_path / "a.png")
    code, _, err = run("apply", file, *SENSOR, "--weather", "rain:rate=0", "-o", tmp_path / "out", "--map", "radiate")
    assert code == 0, err
    assert (tmp_path / "out" / "a.png").read_bytes() == file.read_bytes()


def test_the_arguments_reach_the_transform(run: Any, tmp_path: Path) -> None:
    file = frame(tmp_path / "a.png")
    argv = ("--map", "radiate", "--noise-law", "scale", "--map-clutter-share", "0", "--looks", "2")
    cover = ("--radome-loss-db", "3", "--noise-floor-db", "12")
    out = tmp_path / "out"
    code, text, err = run("apply", "--json", file, *SENSOR, *RAIN, "-o", out, *argv, *cover, "--preview")
    assert code == 0, err
    (entry,) = json.loads(text)["files"]
    assert (entry["noise_law"], entry["noise_floor_db"], entry["clutter_db"]) == ("scale", 12.0, None)
    assert entry["attenuation_db"] > 3.0
    assert (out / "a_preview.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_arrays_go_the_same_way(run: Any, tmp_path: Path, name: str) -> None:
    numbers = np.random.default_rng(0).exponential(size=(60, 16, 9)).astype(np.float32)
    if name == "a.npy":
        np.save(tmp_path / name, numbers)
    else:
        np.savez(tmp_path / name, map=numbers)
    (tmp_path / "layout.yaml").write_text(
        "dims: [range, doppler, azimuth]\nscale: linear\nrange_m: {first: 0.5, step: 0.5}\n"
        "speed_m_per_s: {first: -4, step: 0.5}\nazimuth_deg: {first: 40, step: -10}\n"
    )
    argv = ("--sensor", "radar:awr1843-like", "--map", tmp_path / "layout.yaml")
    code, text, err = run("apply", tmp_path / name, *argv, *RAIN, "-o", tmp_path / "out", "--preview")
    assert code == 0, err
    assert "clutter up to" in text
    wet = read_power_map(tmp_path / "out" / name, str(tmp_path / "layout.yaml"))
    assert wet.axes.shape == (60, 16, 9)
    assert not np.array_equal(wet.values.numpy(), numbers)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["{a}"], "width of a range bin is not in the file"),
        (["{a}", "--map", "radiat"], "radiate"),
        (["{a}", "--map", "radiate", "--clutter"], "--map-clutter-share 0"),
        (["{a}", "--map", "radiate", "--speed", "relative"], "--speed has no meaning for a power map"),
        (["{a}", "--map", "radiate", "--lost", "drop"], "a map keeps all of its cells"),
        (["{a}", "--map", "radiate", "--labels", "label"], "--labels npz"),
        (["{a}", "{points}", "--map", "radiate"], "one after the other"),
        (["{a}", "--map", "radiate", "--looks", "0"], "looks"),
        (["{black}", "--map", "radiate"], "black.png"),
        (["{none}", "--map", "radiate"], "no such file"),
        (["{a}", "--sensor", "camera", "--map", "radiate"], "--map is for a radar"),
    ],
)
def test_a_mistake_is_one_line_and_no_file(run: Any, tmp_path: Path, argv: list[str], said: str) -> None:
    names = {"a": frame(tmp_path / "a.png"), "points": tmp_path / "p.csv", "none": tmp_path / "no.png"}
    names["points"].write_text("x,y,z,speed_m_per_s,rcs\n1,2,0,0,0\n")
    names["black"] = tmp_path / "black.png"
    write_image(names["black"], torch.zeros(1, 200, 400, dtype=torch.uint8))
    sensor = () if "--sensor" in argv else SENSOR
    out = tmp_path / "out"
    code, text, err = run("apply", *sensor, *RAIN, "-o", out, *(part.format(**names) for part in argv))
    assert (code, text) == (2, "")
    last = err.strip().splitlines()[-1]
    assert last.startswith("torchweather: error: ")
    assert said in last
    assert not out.exists() or not list(out.iterdir())
