"""DrawBank: statistics of the exact path, depth test, displacement, files and workers."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather as tw
from torchweather.camera.particles.bank import _KEPT, MOST_BYTES, STORMS, DrawBank
from torchweather.camera.particles.bank_codes import BIN_SHIFT, decoded_codes, encoded
from torchweather.core.compiled import SWITCH
from torchweather.core.errors import TorchweatherWarning
from torchweather.core.exceptions import InputValueError, TorchweatherError
from torchweather.core.random import draw_variates
from torchweather.stages import EFFECTS

HEIGHT, WIDTH = 96, 128
# A long lens: few slots of particles, which keeps the exact path quick.
CAMERA = tw.Camera.from_intrinsics(700, 700, 63.5, 47.5, WIDTH, HEIGHT, lens_blur_px=1.4)


@pytest.fixture(scope="module")
def rain() -> DrawBank:
    """Rain of one rate of the bank and a neighbour."""
    return DrawBank("rain", CAMERA).prepare(20.0, 20.0)


def few_layers() -> DrawBank:
    """A bank that is rendered quickly."""
    return DrawBank("rain", CAMERA, most_bytes=2_000_000)


def places(bank: DrawBank, number: int, seed: int = 0) -> Tensor:
    """Displacements of some samples, ``(number, storms, 3)``."""
    drawn = draw_variates(range(seed, seed + number), "particle_veil", [bank.variate()], {})
    return torch.from_numpy(next(iter(drawn.values())))


def flat(depth_m: float) -> Tensor:
    return torch.full((HEIGHT, WIDTH), depth_m)


def covered(optical: Tensor) -> Tensor:
    return 1.0 - torch.exp(-optical)


# ---- the physics ------------------------------------------------------------------------------------------------


def slow_optical_depth(bank: DrawBank, depth_m: Tensor, rate: float, place: Tensor) -> np.ndarray[Any, Any]:
    """The same pixel by pixel: the layer in front of the depth, both storms, then what is between the nodes."""
    tables = bank.at_rate(rate)
    rows, columns = bank.size
    codes = bank.codes(tables.node).view(STORMS, bank.layers, rows, columns).numpy()
    level = 2e-4 * np.expm1(np.arange(256) * math.log1p(8.0 / 2e-4) / 255)
    seen = np.empty(depth_m.shape)
    for v in range(depth_m.shape[0]):
        for u in range(depth_m.shape[1]):
            depth = min(max(float(depth_m[v, u]), bank.near_m), bank.far_m)
            octave = math.floor(math.log2(depth))
            edge = 2.0**octave * (1 + math.floor((depth / 2.0**octave - 1) * 128) / 128)
            layer = max(int((bank.nodes_m <= edge).sum()) - 1, 0)
            total = 0.0
            for storm, (down, across, mirrored) in enumerate(place.tolist()):
                row, column = (v + int(down * rows)) % rows, (u + int(across * columns)) % columns
                column = columns - 1 - column if mirrored >= 0.5 else column
                total += level[codes[storm, layer, row, column]]
            number = int(np.float32(edge).view(np.int32) >> BIN_SHIFT) - tables.first_bin
            seen[v, u] = total * float(tables.amplitude[number]) + float(tables.even[number])
    return seen


def test_the_look_ups_are_those_of_a_loop_over_pixels(rain: DrawBank) -> None:
    depth_m = torch.exp(torch.linspace(math.log(0.4), math.log(300.0), 12 * 20)).view(12, 20)
    depth_m[0, 0] = torch.inf
    place = places(rain, 1, 5)[0]
    found = rain.optical_depth(depth_m, 21.0, place)
    # Sums of two numbers in single precision.
    torch.testing.assert_close(found.double(), torch.from_numpy(slow_optical_depth(rain, depth_m, 21.0, place)))


def test_no_layer_holds_particles_behind_the_depth_that_takes_it(rain: DrawBank) -> None:
    tables = rain.at_rate(20.0)
    codes = rain.codes(tables.node).view(STORMS, rain.layers, -1)
    assert bool((codes.diff(dim=1).int() >= 0).all())  # layer on layer, the optical depth grows
    depth_m = torch.tensor(np.geomspace(0.5, 200.0, 4000), dtype=torch.float32)
    pixels = rain.size[0] * rain.size[1]
    number = (depth_m.view(torch.int32) >> BIN_SHIFT) - tables.first_bin
    layer = tables.base[number.long()] // pixels
    behind = torch.from_numpy(rain.nodes_m)[layer.long()] > depth_m.double()
    assert bool((tables.amplitude[number.long()][behind] == 0).all())


@pytest.mark.parametrize("depth_m", [0.7, 3.0, 8.0, 31.0, math.inf])
@pytest.mark.parametrize("rate", [18.0, 21.0, 24.0])
def test_the_mean_transmission_is_that_of_the_particles(rain: DrawBank, depth_m: float, rate: float) -> None:
    """``1 - exp(-n A Z)`` in closed form: every particle covers its own area."""
    weather = tw.Rain(rate)
    held = min(depth_m, rain.far_m)
    diameter = torch.linspace(0.02, 8.0, 20001, dtype=torch.float64)
    distribution = weather.distribution(torch.tensor([rate], dtype=torch.float64))
    diameter = diameter.clamp(float(distribution.diameter_min_mm), float(distribution.diameter_max_mm))
    density = distribution.number_density_per_m3_mm(diameter)[0]
    outline = weather.physical_diameter_mm(diameter) * 1e-3
    per_m = float(torch.trapezoid(density * math.pi / 4 * outline.square(), diameter))
    wanted = 1.0 - math.exp(-per_m * (held - rain.near_m))
    found = [float(covered(rain.optical_depth(flat(depth_m), rate, one)).mean()) for one in places(rain, 12)]
    # 1 % of the tables; within a bin of depth up to 0.4 % of it; and the mean of 12 frames of 128 x 96 px.
    error = float(np.std(found)) / math.sqrt(len(found))
    assert np.mean(found) == pytest.approx(wanted, rel=0.01 + 0.004 * held / (held - rain.near_m), abs=3 * error)


def moments(masks: Tensor) -> dict[str, float]:
    """Mean, deviation, neighbours' correlation and 99.9 % quantile of covered shares ``(N, H, W)``."""
    mean = masks.mean()
    apart = masks - masks.mean(0)
    square = apart.square().mean()
    return {
        "mean": float(mean),
        "deviation": float(square.sqrt()) * math.sqrt(len(masks) / (len(masks) - 1)),
        "down": float((apart[:, 1:] * apart[:, :-1]).mean() / square),
        "across": float((apart[..., 1:] * apart[..., :-1]).mean() / square),
        "quantile": float(masks.flatten().kthvalue(int(0.999 * masks.numel())).values),
    }


def exact_and_training(weather: Any, depth_m: Tensor, number: int) -> tuple[dict[str, float], dict[str, float]]:
    found = []
    for quality in ("exact", "training"):
        transform = tw.BayerWeather(weather, CAMERA, airlight=0.7, quality=quality)
        veil: Any = transform.chain.stages["particle_veil"]
        masks = []
        for seed in range(number):
            frame = torch.zeros(1, 3, HEIGHT, WIDTH)
            state = transform.planes_state(frame, transform.scene_of(frame[0], depth_m), ())
            masks.append(covered(veil.optical_depth(state, veil.draw(state, seed=[seed])))[0, 0])
        found.append(moments(torch.stack(masks)))
    return found[0], found[1]


def check_moments(weather: Any, depth_m: Tensor, number: int) -> None:
    exact, training = exact_and_training(weather, depth_m, number)
    # Sampling error of the exact path: as many independent patches as marks of some 100 px have room, both ways.
    patches = number * HEIGHT * WIDTH / 100
    error = exact["deviation"] / math.sqrt(patches)
    assert training["mean"] == pytest.approx(exact["mean"], rel=0.01, abs=3 * error)
    # The fourth moment of shot noise is some 20 times the square of the second: 3 sqrt(20 / 4 patches).
    assert training["deviation"] == pytest.approx(exact["deviation"], rel=0.05 + 3 * math.sqrt(5 / patches))
    assert training["down"] == pytest.approx(exact["down"], abs=0.05 + 3 / math.sqrt(patches))
    assert training["across"] == pytest.approx(exact["across"], abs=0.05 + 3 / math.sqrt(patches))
    assert training["quantile"] == pytest.approx(exact["quantile"], rel=0.1 + 3 / math.sqrt(0.001 * patches * 100))


def ramp() -> Tensor:
    rows = torch.exp(torch.linspace(math.log(60.0), math.log(2.5), HEIGHT))
    return rows[:, None].expand(1, HEIGHT, WIDTH).contiguous()


def test_statistics_are_those_of_the_exact_path() -> None:
    check_moments(tw.Rain(20.0), ramp(), 8)


@pytest.mark.long
@pytest.mark.parametrize(
    "weather", [*(tw.Rain(r) for r in (1.0, 5.0, 10.0, 50.0)), *(tw.Snow(r) for r in (0.5, 2.0, 5.0))]
)
@pytest.mark.parametrize("scene", ["near", "far", "ramp"])
def test_statistics_are_those_of_the_exact_path_at_all_rates(weather: Any, scene: str) -> None:
    depth_m = ramp() if scene == "ramp" else flat(5.0 if scene == "near" else 30.0)[None]
    check_moments(weather, depth_m, 48)


def test_two_samples_are_no_more_alike_than_chance(rain: DrawBank) -> None:
    samples = [rain.optical_depth(flat(30.0), 20.0, one).flatten() for one in places(rain, 40)]
    correlation = torch.corrcoef(torch.stack(samples))
    pairs = correlation[torch.triu(torch.ones_like(correlation), 1) > 0]
    # A storm of half of the particles comes back within a mark's reach (3 x 20 px, mirrored or not) in 1 of 2,000
    # pairs here (256 x 256 px); the rest is chance, 1 / sqrt(patches).
    assert float(pairs.abs().mean()) < 2.0 / math.sqrt(HEIGHT * WIDTH / 100)
    assert float((pairs > 0.3).float().mean()) < 0.01


def test_a_displaced_storm_has_no_seam(rain: DrawBank) -> None:
    rows, columns = rain.size
    depth_m = torch.full((rows, columns), 20.0)
    still = rain.optical_depth(depth_m, 20.0, torch.tensor([[0.0, 0.0, 0.0]] * STORMS))
    moved = rain.optical_depth(depth_m, 20.0, torch.tensor([[0.25, 0.5, 0.0]] * STORMS))
    assert torch.equal(moved, torch.roll(still, (-rows // 4, -columns // 2), (0, 1)))
    edge = (still[:, 0] - still[:, -1]).square().mean()
    inside = (still[:, 1:] - still[:, :-1]).square().mean()
    assert float(edge) == pytest.approx(float(inside), rel=1.0)  # one column of 256 px, few marks


def test_codes_hold_optical_depth_to_two_percent() -> None:
    optical = torch.logspace(-3, 0.9, 1000)
    again = decoded_codes()[encoded(optical).long()]
    assert float((again / optical - 1).abs().max()) < 0.026  # half a step of 4.2 %, and 2e-4 beside 1e-3


# ---- frames ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def picture() -> Tensor:
    generator = torch.Generator().manual_seed(1)
    small = torch.rand(1, 3, 12, 16, generator=generator)
    return (torch.nn.functional.interpolate(small, (HEIGHT, WIDTH), mode="bilinear")[0] * 255).to(torch.uint8)


def rainy(**more: Any) -> tw.AsBayer:
    rate = more.pop("rate", 20.0)
    return tw.AsBayer(tw.BayerRain(tw.Rain(rate), CAMERA, **{"airlight": 0.7, "quality": "training", **more}))


def test_look_ups_of_8_bits_are_the_same_as_linear_light(picture: Tensor) -> None:
    transform, depth_m = rainy(), ramp()
    quick = transform(picture, depth_m, seed=3)
    slow = transform.run(picture, depth_m, seed=3)
    apart = quick.int() - slow.rgb.int()
    # A class of optical depth is 1.6 % wide on either side; colours come from every 16th pixel.
    assert int(apart.abs().max()) <= 2
    assert float(apart.float().mean().abs()) < 0.1
    assert float(slow.particle_mask.mean()) > 0.005


def test_compiled_look_ups_are_those_of_torch_bit_by_bit(picture: Tensor, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    transform, found = rainy(), []
    for switch in "01":
        monkeypatch.setenv(SWITCH, switch)
        found.append([transform(picture, depth_m, seed=3) for depth_m in (ramp(), torch.full((1, HEIGHT, WIDTH), 0.3))])
    assert all(torch.equal(*pair) for pair in zip(*found, strict=True))


def test_rate_zero_gives_every_bit_back(picture: Tensor) -> None:
    for frame in (picture, picture.float() / 255):
        assert torch.equal(rainy(rate=0.0)(frame, ramp(), seed=3), frame)
    one = rainy(rate=0.0)(picture, ramp(), seed=3)
    one += 1
    assert not torch.equal(one, picture)  # a copy


def test_a_batch_is_its_elements(picture: Tensor) -> None:
    transform = rainy(rate=tw.LogUniform(18.0, 22.0))
    batch = torch.stack([picture, picture.flip(-1)])
    together = transform(batch, ramp(), seed=7)
    for row in range(2):
        assert torch.equal(together[row], transform(batch[row], ramp(), seed=7 + row))
    assert torch.equal(together, transform(batch, ramp(), seed=7))


def test_compose_gives_the_drawn_weather_of_the_exact_path(picture: Tensor) -> None:
    law = tw.Rain(rate_mm_per_h=tw.LogUniform(18.0, 22.0))
    sample = {"image": picture, "depth": ramp()}
    composed = {
        quality: tw.Compose({"image": rainy(quality=quality)}, weather=law, history="weather")
        for quality in ("exact", "training")
    }
    exact, training = (composed[quality](sample, seed=5) for quality in ("exact", "training"))
    assert training["weather"]["weather"] == exact["weather"]["weather"]
    assert training["weather"]["quality"] == "training"
    assert "quality" not in exact["weather"]
    ran = composed["training"].run(sample, seed=5)[0]
    assert int((ran["image"].int() - training["image"].int()).abs().max()) <= 2
    again = composed["training"](sample, draw=tw.compose.Draw.from_dict(training["weather"]))
    assert torch.equal(again["image"], training["image"])


def test_a_drawn_airlight_is_that_of_the_record(picture: Tensor) -> None:
    law = tw.Rain(rate_mm_per_h=tw.LogUniform(18.0, 22.0))
    light = rainy(airlight=tw.Uniform(0.2, 0.9))
    composed = tw.Compose({"image": light}, weather=law, history="weather")
    out = composed({"image": picture, "depth": ramp()}, seed=5)
    drawn = out["weather"]["nuisances"]["image"]["airlight"]
    given = tw.Compose({"image": rainy(airlight=drawn)}, weather=law)
    assert torch.equal(out["image"], given({"image": picture, "depth": ramp()}, seed=5)["image"])
    dark = tw.Compose({"image": rainy(airlight=0.1)}, weather=law)
    assert not torch.equal(out["image"], dark({"image": picture, "depth": ramp()}, seed=5)["image"])
    assert light(picture, ramp(), seed=5).shape == picture.shape


def test_random_rain_takes_the_quality(picture: Tensor) -> None:
    weather = tw.RandomRain(20.0, p=1.0, camera=CAMERA, depth=30.0, airlight=0.7, quality="training")
    weather.prepare(HEIGHT, WIDTH)
    assert "training" in repr(weather)
    assert torch.equal(weather(picture, seed=2), weather(picture, seed=2))
    assert not torch.equal(weather(picture, seed=2), weather(picture, seed=3))


# ---- files and workers ---------------------------------------------------------------------------------------------


def test_a_file_gives_the_bank_back(rain: DrawBank, tmp_path: Path) -> None:
    rain.save(tmp_path / "rain.npz")
    again = DrawBank.load(tmp_path / "rain.npz")
    place = places(rain, 1)[0]
    assert again.config() == rain.config()
    assert torch.equal(again.optical_depth(flat(9.0), 20.0, place), rain.optical_depth(flat(9.0), 20.0, place))
    whole = (tmp_path / "rain.npz").read_bytes()
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(TorchweatherError, match="truncated"):
        DrawBank.load(tmp_path / "half.npz")
    np.savez(tmp_path / "other.npz", config=np.array("{}"))
    with pytest.raises(TorchweatherError, match="expected a bank"):
        DrawBank.load(tmp_path / "other.npz")


def test_a_bank_is_the_same_in_any_process_and_order() -> None:
    place = torch.tensor([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    first, second = few_layers(), few_layers()
    second.codes(second.node_of(28.0))
    assert torch.equal(first.optical_depth(flat(9.0), 20.0, place), second.optical_depth(flat(9.0), 20.0, place))


def test_a_worker_takes_the_bank_that_it_is_handed() -> None:
    bank = few_layers()
    node = bank.node_of(20.0)
    assert bank.codes(node).is_shared()
    handed = pickle.dumps(bank)
    _KEPT.clear()  # as in a process that was spawned
    again = pickle.loads(handed)
    assert torch.equal(again.codes(node), bank.codes(node))
    assert DrawBank.shared(bank.weather, CAMERA, most_bytes=2_000_000) is again


def test_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    assert DrawBank("rain", tw.Camera.preset("lucid-triton")).most_bytes == MOST_BYTES
    for camera in (CAMERA, tw.Camera.preset("lucid-triton"), tw.Camera.preset("lucid-triton").fitted_to(1242, 375)):
        bank = DrawBank("snow", camera)
        assert bank.most_rates * bank.layers * STORMS * bank.size[0] * bank.size[1] <= MOST_BYTES
    small = few_layers()
    codes = torch.zeros(STORMS, small.layers * small.size[0] * small.size[1], dtype=torch.uint8)
    for node in range(small.most_rates + 4):
        small._keep(node, codes.clone(), torch.zeros(0))
    assert small.number_of_bytes <= 2_000_000
    assert list(small._codes) == list(range(4, small.most_rates + 4))  # those of long ago are dropped
    large = DrawBank("rain", tw.Camera.preset("lucid-triton"))
    assert large.node_of(50.0) - large.node_of(1.0) < large.most_rates  # the default rates are rendered once
    monkeypatch.setattr(small, "codes", lambda node: None)
    with pytest.warns(TorchweatherWarning, match="do not fit"):
        small.prepare(1.0, small.rate_ratio**small.most_rates)
    with pytest.raises(InputValueError, match="most_bytes"):
        DrawBank("rain", tw.Camera.preset("lucid-triton"), most_bytes=2_000_000)


# ---- refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("weather", "camera", "options", "said"),
    [
        (tw.Rain(5.0), {"pitch_rad": 0.1}, {}, "pitched"),
        (tw.Rain(5.0), {"k1": -0.1}, {}, "distorts"),
        (tw.Rain(5.0, wind_m_per_s=(3.0, 0.0, 0.0)), {}, {}, "wind"),
        (tw.Rain(5.0, patch_log_std=0.5), {}, {}, "gusts"),
        (tw.Rain(5.0), {}, {"ego_speed_m_per_s": 5.0}, "ego_speed"),
        (tw.Rain(5.0), {}, {"variant": "d3_4"}, "variant"),
        (tw.Mixture(tw.Rain(5.0), tw.Fog(mor_m=200)), {}, {}, "fog"),
        (tw.Rain(5.0), {}, {"quality": "fast"}, "quality must be"),
        (tw.Rain(5.0), {"exposure_s": tw.Uniform(1e-3, 5e-3)}, {}, "one camera"),
        (tw.Rain(5.0, temperature_c=tw.Uniform(1.0, 20.0)), {}, {}, "distribution for temperature_c"),
    ],
)
def test_what_a_bank_cannot_follow_is_refused(
    weather: Any, camera: dict[str, Any], options: dict[str, Any], said: str
) -> None:
    taken = replace(CAMERA, **camera)
    with pytest.raises(InputValueError, match=said):
        tw.BayerWeather(weather, taken, **{"quality": "training", **options})


def test_sideways_wind_is_not_mirrored() -> None:
    assert DrawBank(tw.Rain(1.0), CAMERA).mirrors
    assert not DrawBank(tw.Rain(1.0, wind_m_per_s=(0.0, 3.0, 0.0)), CAMERA).mirrors


def test_a_bank_of_another_camera_or_rate_is_refused(rain: DrawBank) -> None:
    assert tw.BayerRain(tw.Rain(5.0), CAMERA, quality=rain).quality is rain
    with pytest.raises(InputValueError, match="built for camera"):
        tw.BayerRain(tw.Rain(5.0), tw.Camera.preset("lucid-triton"), quality=rain)
    with pytest.raises(InputValueError, match="rate_capacity_mm_per_h=150"):
        rain.optical_depth(flat(9.0), 150.0, torch.zeros(STORMS, 3))
    with pytest.raises(InputValueError, match="Fog needs no bank"):
        DrawBank("fog", CAMERA)
    with pytest.raises(InputValueError, match="at most 256 x 256"):
        rain.optical_depth(torch.ones(300, 300), 20.0, torch.zeros(STORMS, 3))


def test_sequences_gusts_and_rolling_shutters_are_refused(picture: Tensor) -> None:
    transform = rainy()
    with pytest.raises(InputValueError, match="frame to frame"):
        list(transform.draw_sequence(picture, 2, 0.1, seed=1))
    with pytest.raises(InputValueError, match="at rest"):
        transform.at_ego_speed(3.0)
    for effect, said in (
        (EFFECTS["camera.wind_slant"](angle_rad=0.3), "slanted"),
        (EFFECTS["camera.rolling_shutter"](row_time_s=2e-5), "rolling shutter"),
    ):
        slanted = rainy(effects=[effect])
        with pytest.raises(InputValueError, match=said):
            slanted(picture, ramp(), seed=1)
