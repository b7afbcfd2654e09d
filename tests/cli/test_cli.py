"""The command line: light to start, numbers with units, files whole or not at all, mistakes in one line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import types
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather
from tests.listed_names import FILE, text_of_names
from torchweather.atmosphere.weather import Fog, Rain, parse_weather
from torchweather.cli import main
from torchweather.explain import explain
from torchweather.image import ConstantDepth, quantise
from torchweather.io import read_image, write_image
from torchweather.physics import mor_from_extinction
from torchweather.sensors import Camera
from torchweather.transforms import AsBayer, BayerWeather


@pytest.fixture
def explained(run: Any) -> Any:
    def call(weather: str, sensor: str, *more: str) -> dict[str, Any]:
        code, out, _ = run("explain", "--weather", weather, "--sensor", sensor, "--json", *more)
        assert code == 0
        values: dict[str, Any] = json.loads(out)
        return values

    return call


def raw_frame(height: int = 24, width: int = 32) -> Tensor:
    values = torch.rand(1, height, width, generator=torch.Generator().manual_seed(5)) * 2000 + 200
    values[:, : height // 3] = 3000  # sky
    return values.to(torch.int32).to(torch.uint16)


def rgb_image(height: int = 25, width: int = 33) -> Tensor:
    return quantise(torch.rand(3, height, width, generator=torch.Generator().manual_seed(6)), torch.uint8)


def small_camera(height: int = 24, width: int = 32) -> Camera:
    return Camera.preset("lucid-triton").resized(width, height)


# ---- starting ------------------------------------------------------------------------------------------------------

LIGHT = """
import sys
{body}
heavy = [name for name in ("torch", "numpy", "yaml", "matplotlib", "onnxruntime", "scipy") if name in sys.modules]
sys.exit(", ".join(heavy) or 0)
"""
HELP = """
from torchweather.cli import main
try:
    main({argv})
except SystemExit as end:
    assert end.code == 0, end.code
"""


@pytest.mark.parametrize(
    "body",
    [
        "import torchweather",
        HELP.format(argv=["--help"]),
        HELP.format(argv=["apply", "-h"]),
        "from torchweather.cli import main\nassert main(['list']) == main(['list', '--json']) == 0",
        HELP.format(argv=["explain", "--wether", "rain:rate=1"]).replace("code == 0", "code == 2"),
        HELP.format(argv=["view", "--no-such"]).replace("code == 0", "code == 2"),
    ],
)
def test_import_help_names_and_errors_of_arguments_do_not_load_torch(body: str) -> None:
    found = subprocess.run([sys.executable, "-c", LIGHT.format(body=body)], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr


def test_public_names_resolve_and_others_do_not() -> None:
    for name in torchweather.__all__:
        assert getattr(torchweather, name) is not None
    assert torchweather.Rain is Rain
    assert {"BayerFog", "Camera"} <= set(dir(torchweather))
    with pytest.raises(AttributeError, match="LidarRian"):
        torchweather.LidarRian  # noqa: B018


# ---- explain -------------------------------------------------------------------------------------------------------


def test_explain_gives_the_keys_of_a_camera(explained: Any) -> None:
    numbers = explained("rain:rate=25", "camera:lucid-triton")
    assert numbers["weather"]["rate_mm_per_h"] == 25
    assert numbers["sensor"] == "camera:lucid-triton"
    assert [(band["name"], band["wavelength_nm"]) for band in numbers["bands"]] == [
        ("red", 600),
        ("green", 530),
        ("blue", 460),
    ]
    for band in numbers["bands"]:
        extinctions = {"extinction_per_m", "extinction_rendered_per_m"}
        assert set(band) == {"name", "wavelength_nm", "backscatter_per_m_sr", *extinctions}
    assert {"mor_m", "particles_per_m3", "liquid_water_g_per_m3"} <= set(numbers)


def test_rain_of_25_mm_per_h_has_the_extinction_of_closed_form(explained: Any) -> None:
    # 8000 pi / Lambda^3 1e-6 with Lambda = 4.1 R^-0.21 (Q = 2, all sizes). The domain 0.1-8 mm loses up to 0.9 %, Mie
    # is up to 1 % above 2.
    closed_form = 8000 * math.pi / (4.1 * 25**-0.21) ** 3 * 1e-6
    numbers = explained("rain:rate=25", "lidar:ouster-os1-128")
    (band,) = numbers["bands"]
    assert band["extinction_per_m"] == pytest.approx(closed_form, rel=0.015)
    assert band["extinction_effective_per_m"] == pytest.approx(0.55 * band["extinction_per_m"])  # q_eff = 1.1
    # beta = Q_back / (4 pi) times the geometric cross-section, which is half of the extinction.
    assert band["backscatter_per_m_sr"] == pytest.approx(0.2 / (4 * math.pi) * closed_form / 2, rel=0.015)
    # Drops of 0.1-8 mm: N0 / Lambda (e^-0.1 Lambda - e^-8 Lambda).
    slope = 4.1 * 25**-0.21
    count = 8000 / slope * (math.exp(-0.1 * slope) - math.exp(-8 * slope))
    assert numbers["particles_per_m3"] == pytest.approx(count, rel=1e-6)
    assert numbers["mor_m"] == pytest.approx(math.log(20) / band["extinction_per_m"], rel=2e-3)


def test_fog_tells_its_nominal_visibility_and_that_of_mie_theory(explained: Any) -> None:
    scaled = explained("fog:mor=30", "camera")
    assert scaled["mor_nominal_m"] == 30
    assert scaled["mor_m"] == pytest.approx(30, rel=1e-6)
    measured = explained("fog:mor=30,size_distribution=rehearse", "camera")
    assert measured["mor_nominal_m"] == 30
    # PHYSICS: 27.1 m at 530 nm; at 550 nm the extinction is 0.2 % higher.
    assert measured["mor_m"] == pytest.approx(27.1, rel=0.005)
    assert measured["bands"][1]["extinction_per_m"] == pytest.approx(0.1104, abs=5e-5)  # Table 13, corrected, green


@pytest.mark.parametrize(
    ("weather", "more", "expected"),
    [
        ("rain:rate=25", (), 11.41),  # ITU-R P.838-3: 1.13197 R^0.71768
        ("rain:rate=25", ("--polarisation", "v"), 1.12762 * 25**0.70729),
        ("rain:rate=25", ("--frequency-ghz", "24"), 0.14250 * 25**1.01011),
        ("fog:mor=50,size_distribution=rehearse", (), 0.42),  # P.840 at 10 degrees times 0.132 g/m^3
    ],
)
def test_radar_gives_the_one_way_attenuation(
    explained: Any, weather: str, more: tuple[str, ...], expected: float
) -> None:
    numbers = explained(weather, "radar", *more)
    (band,) = numbers["bands"]
    assert numbers["attenuation_db_per_km"] == band["attenuation_db_per_km"] == pytest.approx(expected, rel=0.01)
    # 1/m of power is 4342.945 dB/km.
    assert band["extinction_per_m"] * 4342.945 == pytest.approx(band["attenuation_db_per_km"], rel=1e-6)


def test_snow_on_radar_is_dry_snow_after_mie(explained: Any) -> None:
    # PHYSICS 6.7: 0.18-0.20 dB/km at 1 mm/h.
    assert 0.18 <= explained("snow:rate=1", "radar")["attenuation_db_per_km"] <= 0.20


def test_wavelength_leaves_one_band(explained: Any) -> None:
    (band,) = explained("rain:rate=25", "lidar", "--wavelength-nm", "1550")["bands"]
    (reference,) = explained("rain:rate=25", "lidar")["bands"]
    assert band["wavelength_nm"] == 1550
    # Q_back of rain is 0.06 there and 0.2 at 865 nm.
    assert band["backscatter_per_m_sr"] == pytest.approx(0.3 * reference["backscatter_per_m_sr"], rel=1e-6)
    (green,) = explained("fog:mor=30", "camera", "--wavelength-nm", "530")["bands"]
    assert green["name"] == "green"


def test_extinctions_of_a_mixture_add(explained: Any) -> None:
    both = explained("rain:rate=10+fog:mor=200", "lidar")
    alone = [explained(weather, "lidar") for weather in ("rain:rate=10", "fog:mor=200")]
    for key in ("extinction_per_m", "extinction_effective_per_m", "backscatter_per_m_sr"):
        assert both["bands"][0][key] == pytest.approx(sum(n["bands"][0][key] for n in alone))
    assert both["liquid_water_g_per_m3"] == pytest.approx(sum(n["liquid_water_g_per_m3"] for n in alone))
    assert 1 / both["mor_m"] == pytest.approx(sum(1 / n["mor_m"] for n in alone))
    assert [part["kind"] for part in both["parts"]] == ["fog", "rain"]


@pytest.mark.parametrize("sensor", ["camera:sekonix-sf3325", "lidar:velodyne-hdl-64e", "radar:awr1843-like"])
@pytest.mark.parametrize("weather", ["rain:rate=0", "fog:mor=inf", "snow:rate=0"])
def test_no_weather_takes_nothing(explained: Any, weather: str, sensor: str) -> None:
    numbers = explained(weather, sensor)
    assert numbers["mor_m"] is None  # unlimited
    assert numbers["particles_per_m3"] == 0
    assert all(band["extinction_per_m"] == 0 and band["backscatter_per_m_sr"] == 0 for band in numbers["bands"])


def test_closed_rate_is_the_rate_that_the_drops_carry() -> None:
    numbers = explain(Rain(25.0, close_rate=True), Camera.preset("lucid-triton"))
    assert numbers["parts"][0]["rate_carried_mm_per_h"] == pytest.approx(25, rel=1e-6)
    assert numbers["sensor"] == "camera"


def test_median_volume_diameter_halves_the_water() -> None:
    weather = Rain(10.0)
    median = explain(weather, "camera")["parts"][0]["median_volume_diameter_mm"]
    distribution = weather.distribution()
    below = distribution.moment(3.0, high_mm=torch.tensor([median], dtype=torch.float64))
    assert float(below) == pytest.approx(0.5 * float(distribution.moment(3.0)), rel=1e-9)


def test_explain_takes_one_sample_at_a_time() -> None:
    with pytest.raises(ValueError, match="one number"):
        explain(Fog(mor_m=torch.tensor([30.0, 50.0])), "camera")
    assert explain(Fog(mor_m=torch.tensor(30.0)), "camera")["mor_nominal_m"] == 30


def test_explain_says_that_a_weather_is_patchy(run: Any) -> None:
    code, out, _ = run("explain", "--weather", "fog:mor=120,patches=0.7,patch_length=15+rain:rate=5")
    assert code == 0
    assert "fog (mor_m=120, in patches, whose mean this is) with rain (rate_mm_per_h=5)" in out


def test_explain_as_text_names_units_and_q_eff(run: Any) -> None:
    _, out, _ = run("explain", "--weather", "rain:rate=25", "--sensor", "lidar")
    for text in ("865 nm", "extinction 1/m", "backscatter 1/(m sr)", "q_eff = 1.1 for rain", "g/m^3", "mm/h"):
        assert text in out
    _, out, _ = run("explain", "--weather", "rain:rate=25", "--sensor", "radar")
    assert "dB/km, one way" in out
    assert "P.838" in out


# ---- d34, list -----------------------------------------------------------------------------------------------------


def test_table13_as_published_equals_the_print_except_its_misprint(run: Any) -> None:
    code, out, _ = run("d34", "table13", "--json")
    rows = json.loads(out)
    assert code == 0
    assert len(rows) == 12
    differing = [
        (row["visibility_m"], row["colour"]) for row in rows if round(row["as_published"], 4) != row["printed"]
    ]
    assert differing == [(10, "red")]
    corrected = {(row["visibility_m"], row["colour"]): row["corrected"] for row in rows}
    assert corrected[50, "blue"] == pytest.approx(0.0664, abs=5e-5)
    _, text, _ = run("d34", "table13")
    assert "as published" in text
    assert "0.2979" in text


def test_listed_names_are_those_of_the_library() -> None:
    assert FILE.read_text(encoding="utf-8") == text_of_names(), "write it anew: python -m tests.listed_names"


def test_list_names_everything(run: Any) -> None:
    code, out, _ = run("list", "--json")
    names = json.loads(out)
    assert code == 0
    assert {"name", "kind", "title", "transform", "weather", "sensor"} <= set(names["recipes"][0])
    for old, kind in (("pipelines", "multi_sensor"), ("suites", "suite")):
        assert names[old] == [recipe for recipe in names["recipes"] if recipe["kind"] == kind] != []
    assert "camera/rain-25mm-per-h" in [recipe["name"] for recipe in names["recipes"]]
    assert {"camera:lucid-triton", "lidar:ouster-os1-128", "radar:imaging-77ghz"} <= {
        sensor["name"] for sensor in names["sensors"]
    }
    assert all(sensor["source"] for sensor in names["sensors"])
    assert "ParticleVeil" in names["stages"]
    # Every name of a distribution is one that --weather takes.
    for kind, distributions in names["size_distributions"].items():
        intensity = "mor=30" if kind == "fog" else "rate=1"
        for distribution in distributions:
            assert parse_weather(f"{kind}:{intensity},size_distribution={distribution}").kind == kind
    _, text, _ = run("list")
    assert "camera/fog-30m" in text


# ---- apply ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".npy", ".npz"])
def test_apply_writes_what_the_transform_gives_under_the_same_name(run: Any, tmp_path: Path, suffix: str) -> None:
    frame = raw_frame()
    source = tmp_path / f"frame{suffix}"
    write_image(source, frame)
    code, out, err = run(
        "apply", "--weather", "rain:rate=20+fog:mor=60", source, "--out", tmp_path / "out", "--depth", 40, "--json",
        "--airlight", 0.7, 0.7, 0.75, "--seed", 9, "--quiet",
    )  # fmt: skip
    assert (code, err) == (0, "")
    (entry,) = json.loads(out)["files"]
    transform = BayerWeather(
        parse_weather("rain:rate=20+fog:mor=60"), small_camera(), depth=40.0, airlight=(0.7, 0.7, 0.75)
    )
    expected = transform.run(frame, noise=transform.draw(frame, seed=9))
    written, _ = read_image(tmp_path / "out" / source.name)
    assert written.dtype == torch.uint16
    assert torch.equal(written.int(), expected.bayer.int())
    assert entry["input"] == str(source)
    assert entry["output"] == str(tmp_path / "out" / source.name)
    assert entry["seed"] == 9
    assert entry["weather"]["kind"] == "mixture"
    assert entry["transmission_mean"] == pytest.approx(float(expected.transmission.mean()))
    assert entry["particle_mask_mean"] == pytest.approx(float(expected.particle_mask.mean()))
    assert entry["airlight"] == pytest.approx([0.7, 0.7, 0.75])
    assert entry["seconds"] > 0


@pytest.mark.filterwarnings("ignore:.*no sky in the frame")
def test_samples_take_seed_plus_their_number_and_depth_is_guessed_without_one(run: Any, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    batch = torch.stack([raw_frame(), raw_frame()])
    write_image(folder / "a.npy", batch)
    write_image(folder / "b.png", rgb_image())
    code, out, err = run("apply", "--weather", "snow:rate=1", folder, "--out", tmp_path / "out", "--seed", 4, "--json")
    assert code == 0
    assert "flat ground 1.5 m" in err
    assert "scaled to them" in err
    assert [entry["seed"] for entry in json.loads(out)["files"]] == [4, 6]
    assert "depth is guessed: flat ground" in err  # of the photograph, with walls and sky
    assert [entry["depth"] for entry in json.loads(out)["files"]] == ["guessed", "guessed"]
    transform = AsBayer(BayerWeather(parse_weather("snow:rate=1"), small_camera(25, 33), depth="auto"))
    expected = transform(rgb_image(), noise=transform.draw(rgb_image(), seed=6))
    assert torch.equal(read_image(tmp_path / "out" / "b.png")[0], expected)
    _, text, _ = run("apply", "--weather", "snow:rate=1", folder / "b.png", "--out", tmp_path / "out", "--quiet")
    assert "particle mask" in text


def test_no_weather_writes_the_same_values(run: Any, tmp_path: Path) -> None:
    write_image(tmp_path / "raw.png", raw_frame())
    write_image(tmp_path / "rgb.png", rgb_image())
    code, _, _ = run(
        "apply", "--weather", "fog:mor=inf", tmp_path / "raw.png", tmp_path / "rgb.png", "-o", tmp_path / "out"
    )
    assert code == 0
    for name in ("raw.png", "rgb.png"):
        assert torch.equal(read_image(tmp_path / "out" / name)[0].int(), read_image(tmp_path / name)[0].int())


def test_depth_comes_from_a_file_a_folder_or_a_number(run: Any, tmp_path: Path) -> None:
    write_image(tmp_path / "frame.png", raw_frame())
    depth = np.full((24, 32), 12.0, dtype=np.float32)
    depth[:8] = 30.0
    np.save(tmp_path / "depth.npy", depth)
    maps = tmp_path / "maps"
    maps.mkdir()
    millimetres = depth * 1000
    write_image(maps / "frame.png", torch.from_numpy(millimetres.astype(np.int32)).to(torch.uint16))
    means = []
    for number, given in enumerate(
        (["--depth", tmp_path / "depth.npy"], ["--depth", maps, "--depth-encoding", "millimetre"])
    ):
        _, out, _ = run(
            "apply", "--weather", "fog:mor=30", tmp_path / "frame.png", "-o", tmp_path / str(number), "--json", *given
        )
        means.append(json.loads(out)["files"][0]["transmission_mean"])
    assert means[0] == pytest.approx(means[1])
    # Two thirds at 12 m and one at 30 m of 30 m visibility, along rays up to 1.4 times as long.
    shares = [2 / 3 * 0.05 ** (stretch * 12 / 30) + 1 / 3 * 0.05**stretch for stretch in (1.4, 1.0)]
    assert shares[0] < means[0] < shares[1]


def test_camera_arguments_reach_the_transform(run: Any, tmp_path: Path) -> None:
    frame = raw_frame()
    write_image(tmp_path / "frame.png", frame)
    code, _, err = run(
        "apply", "--weather", "rain:rate=50", tmp_path / "frame.png", "-o", tmp_path / "out", "--depth", 30,
        "--airlight", 0.7, 0.7, 0.7, "--fx", 100, "--cx", 10, "--pattern", "GRBG", "--exposure-s", 0.01,
        "--bit-depth", 14, "--ego-speed-m-per-s", 10,
    )  # fmt: skip
    assert (code, err) == (0, "")
    camera = Camera.from_intrinsics(
        100.0,
        100.0,
        10.0,
        11.5,
        32,
        24,
        bayer_pattern="GRBG",
        exposure_s=0.01,
        bit_depth=14,
        focal_length_mm=6.0,
        lens_blur_px=2.2,
    )
    transform = BayerWeather(Rain(50.0), camera, depth=30.0, airlight=(0.7, 0.7, 0.7), ego_speed_m_per_s=10.0)
    expected = transform(frame, noise=transform.draw(frame, seed=0))
    assert torch.equal(read_image(tmp_path / "out" / "frame.png")[0].int(), expected.int())


def test_a_recipe_gives_weather_sensor_and_options_and_arguments_go_first(run: Any, tmp_path: Path) -> None:
    write_image(tmp_path / "frame.png", raw_frame())
    recipe = tmp_path / "mine.yaml"
    recipe.write_text(
        "format: torchweather-recipe/2\nkind: transform\ntitle: mine\ntransform: BayerFog\n"
        "weather: {kind: fog, mor_m: 40}\n"
        "sensor: {kind: camera, preset: gopro-hero5-acdc}\noptions: {airlight: 0.6, depth: 25}\n"
    )
    argv = ["apply", "--recipe", recipe, tmp_path / "frame.png", "-o", tmp_path / "out", "--json", "--quiet"]
    (entry,) = json.loads(run(*argv)[1])["files"]
    assert entry["weather"]["mor_m"] == 40
    assert entry["airlight"] == pytest.approx([0.6] * 3)
    (other,) = json.loads(run(*argv, "--airlight", 0.5, 0.5, 0.5, "--depth", 5)[1])["files"]
    assert other["airlight"] == pytest.approx([0.5] * 3)
    assert other["transmission_mean"] > entry["transmission_mean"]


# ---- demo ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def demo_calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A stand-in for the page, which has tests of its own."""
    calls: list[dict[str, Any]] = []

    def write_demo(out_dir: Path, **options: Any) -> dict[str, Any]:
        calls.append({"out_dir": out_dir, **options})
        return {"seed": options["seed"], "page": out_dir / "index.html", "mor_m": math.inf}

    module = types.ModuleType("torchweather.report.demo")
    module.write_demo = write_demo  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torchweather.report.demo", module)
    return calls


def test_demo_hands_over_folder_and_seed(run: Any, demo_calls: list[dict[str, Any]], tmp_path: Path) -> None:
    code, out, _ = run("demo", "--out", tmp_path / "page", "--seed", 3, "--json")
    assert code == 0
    assert json.loads(out) == {"seed": 3, "page": str(tmp_path / "page" / "index.html"), "mor_m": None}
    assert demo_calls == [{"out_dir": tmp_path / "page", "seed": 3, "images": [], "progress": False}]
    assert "index.html" in run("demo")[1]
    assert demo_calls[1]["out_dir"] == Path("torchweather-demo")


def test_demo_takes_frames_with_camera_and_depth(run: Any, demo_calls: list[dict[str, Any]], tmp_path: Path) -> None:
    write_image(tmp_path / "frame.png", raw_frame())
    assert run("demo", tmp_path / "frame.png", "-o", tmp_path / "page", "--fx", 100)[0] == 0
    (call,) = demo_calls
    assert call["images"] == [tmp_path / "frame.png"]
    assert "depth" not in call  # the page's own default, which it names
    assert (call["camera"].width, call["camera"].fx, call["camera"].fy) == (32, 100.0, 100.0)
    assert run("demo", tmp_path / "frame.png", "--depth", 30)[0] == 0
    assert demo_calls[1]["depth"] == [ConstantDepth(30.0)]
    assert "camera" not in demo_calls[1]
    assert run("demo", "--depth", 30)[0] == 2


# ---- mistakes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["explain", "--weather", "rian:rate=25"], "'rain'"),
        (["explain", "--weather", "rain:rate=-3"], "mm/h"),
        (["explain", "--weather", "rain:rate=1e5"], "mm/h"),
        (["explain", "--weather", "fog:mor=0"], "mor_m must be above 0 m"),
        (["explain", "--weather", "rain:rate"], "key=value"),
        (["explain", "--weather", "fog:mor=30", "--sensor", "camera:lucid-tritn"], "'lucid-triton'"),
        (["explain", "--weather", "fog:mor=30", "--sensor", "sonar"], "camera, lidar, radar"),
        (["explain", "--weather", "fog:mor=30", "--frequency-ghz", "77"], "wavelength_nm"),
        (["explain", "--weather", "fog:mor=30", "--sensor", "radar", "--wavelength-nm", "905"], "frequency_ghz"),
        (["explain", "--weather", "fog:mor=30", "--sensor", "radar", "--polarisation", "x"], "h, v"),
        (["apply", "{frame}", "-o", "{out}"], "--weather"),
        (["apply", "--weather", "fog:mor=30", "{none}", "-o", "{out}"], "no such file"),
        (["apply", "--weather", "fog:mor=30", "{text}", "-o", "{out}"], "expected an image"),
        (["apply", "--weather", "fog:mor=30", "{cut}", "-o", "{out}"], "truncated"),
        (["apply", "--weather", "fog:mor=30", "{odd}", "-o", "{out}"], "must be even"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{here}"], "overwritten"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "{frame}", "-o", "{out}"], "both"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--depth", "{none}"], "--depth"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--depth", "-1"], "depth_m"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--depth", "{nan}"], "NaN"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--depth", "{frame}"], "millimetre"),
        (
            ["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--depth", "{empty}"],
            "no depth map for frame.png",
        ),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--bit-depth", "8"], "--bit-depth"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--pattern", "RGB"], "RGGB"),
        (["apply", "--weather", "fog:mor=30", "{frame}", "-o", "{out}", "--sensor", "lidar"], "camera"),
        (["apply", "--weather", "fog:mor=30", "{empty}", "-o", "{out}"], "no images"),
        (["apply", "--recipe", "fog-31m", "{frame}", "-o", "{out}"], "fog-30m"),
    ],
)
def test_a_mistake_gives_one_line_exit_code_2_and_no_file(run: Any, tmp_path: Path, argv: list[str], said: str) -> None:
    here = tmp_path / "in"
    (here / "empty").mkdir(parents=True)
    write_image(here / "frame.png", raw_frame())
    write_image(here / "odd.npy", raw_frame(23, 31))
    (here / "cut.png").write_bytes((here / "frame.png").read_bytes()[:200])
    (here / "text.txt").write_text("no image")
    np.save(here / "nan.npy", np.full((24, 32), np.nan, dtype=np.float32))
    names = {
        "frame": here / "frame.png",
        "odd": here / "odd.npy",
        "cut": here / "cut.png",
        "text": here / "text.txt",
        "nan": here / "nan.npy",
        "none": here / "none.png",
        "empty": here / "empty",
        "here": here,
        "out": tmp_path / "out",
    }
    before = sorted(here.rglob("*"))
    code, out, err = run(*(argument.format(**names) for argument in argv))
    assert code == 2
    assert out == ""
    *_, last = err.strip().splitlines()
    assert last.startswith("torchweather: error: ")
    assert said in last
    assert "Traceback" not in err
    assert not (tmp_path / "out").exists()
    assert sorted(here.rglob("*")) == before


def test_an_argument_that_does_not_exist_is_refused_with_code_2() -> None:
    for argv in (["explain", "--wether", "rain:rate=1"], ["d34", "table14"], []):
        with pytest.raises(SystemExit) as caught:
            main(argv)
        assert caught.value.code == 2


def test_debug_shows_where_it_went_wrong() -> None:
    with pytest.raises(ValueError, match="rate_mm_per_h"):
        main(["explain", "--weather", "rain:rate=-3", "--debug"])


def test_a_rate_outside_the_measured_range_warns_in_one_line(run: Any) -> None:
    with warnings.catch_warnings():
        code, out, err = run("explain", "--weather", "rain:rate=300")
    assert code == 0
    assert out
    (line,) = err.strip().splitlines()
    assert line.startswith("torchweather: warning: ")
    assert "0.1..200 mm/h" in line


def test_a_failure_keeps_the_files_that_were_finished_and_names_the_frame(run: Any, tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", raw_frame())
    write_image(tmp_path / "b.npy", raw_frame(23, 31))
    out = tmp_path / "out"
    code, _, err = run("apply", "--weather", "fog:mor=30", tmp_path / "a.png", tmp_path / "b.npy", "-o", out)
    assert code == 1
    assert "b.npy" in err
    assert [path.name for path in out.iterdir()] == ["a.png"]


def test_visibility_of_the_explanation_is_that_of_its_extinction() -> None:
    numbers = explain("snow:rate=2", "camera", wavelength_nm=550.0)
    assert numbers["mor_m"] == pytest.approx(float(mor_from_extinction(numbers["bands"][0]["extinction_per_m"])))
