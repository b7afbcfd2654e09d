"""The effects of cameras: what holds for all of them, and what each does against slow calculations of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from numpy.typing import NDArray
from torch import Tensor

from tests.camera.effects.camera_effect_scene import (
    ACTIVE,
    CAMERA_EFFECTS,
    FOCAL_PX,
    LIGHT,
    H,
    W,
    active,
    begin,
    camera,
    colour_of,
    depth,
    frame,
    normals,
    rain_in_fog,
)
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.camera.effects.optics import CameraAdherentDrops
from torchweather.camera.particles.streaks import Marks, add_listed
from torchweather.export import draw_feed, to_onnx
from torchweather.pipeline.effect import CAMERA_PLACES
from torchweather.recipes import load_recipe, save_recipe
from torchweather.stages import EFFECTS, CameraState, Chain, ParticleVeil, effect_from_dict, with_effects
from torchweather.transforms import BayerFog, BayerRain, BayerSnow, BayerWeather

Array = NDArray[np.float64]
inf = math.inf

# The names and identities of the catalogue; None where a parameter says only where or how.
CATALOGUE: dict[str, dict[str, float | None]] = {
    "camera.exposure_gain": {"factor": 1.0},
    "camera.airlight_scale": {"red": 1.0, "green": 1.0, "blue": 1.0},
    "camera.extinction_scale": {"factor": 1.0, "wavelength_exponent": 0.0},
    "camera.stray_light": {"offset": 0.0, "share": 0.0},
    "camera.aerosol_glow": {"share_per_optical_depth": 0.0, "width_px_per_optical_depth": None},
    "camera.defocus": {"radius_px": 0.0},
    "camera.ego_blur": {"length_px": 0.0, "angle_rad": None},
    "camera.adherent_drops": {"cover": 0.0},
    "camera.vignetting": {"strength": 0.0},
    "camera.wind_slant": {"angle_rad": 0.0},
    "camera.wet_surface": {"darkening": 0.0, "mirror": 0.0},
    "camera.sensor_noise": {"electrons_per_unit": inf, "read_electrons": 0.0},
    "camera.tone_curve": {"gamma": 1.0},
    "camera.saturation": {"level": inf},
    "camera.patchy_fog": {"log_std": 0.0},
    "camera.height_fog": {"scale_height_m": inf},
    "camera.streak_contrast": {"factor": 1.0},
    "camera.particle_count": {"factor": 1.0, "depth_max_m": inf},
    "camera.rolling_shutter": {"row_time_s": 0.0},
    "camera.snow_cover": {"depth_mm": 0.0, "albedo": None, "uneven": None},
    "camera.road_spray": {
        "water_g_per_m": 0.0,
        "drop_mm": None,
        "distance_m": None,
        "lateral_m": None,
        "length_m": None,
        "height_m": None,
        "uneven": None,
    },
    "camera.refracting_drops": {"cover": 0.0, "blur_px": None, "contact_deg": None},
}
every_effect = pytest.mark.parametrize("name", CAMERA_EFFECTS)
# Normals are no input of a graph, and its footprints have no room for longer streaks.
NOT_IN_A_GRAPH = {
    "camera.wet_surface": "expected a state with normal",
    "camera.rolling_shutter": "leave it out",
    "camera.snow_cover": "expected a state with normal",
    "camera.refracting_drops": "no graph can hold it",
}


@pytest.fixture(scope="module")
def plain() -> BayerWeather:
    return rain_in_fog()


def chain_with(transform: BayerWeather, name: str, **values: Any) -> Chain:
    return with_effects(transform.chain, [EFFECTS[name](**values)])


def alone(name: str, state: CameraState, noise: Mapping[str, Tensor] | None = None, **values: Any) -> CameraState:
    """The state behind an effect by itself."""
    found: CameraState = EFFECTS[name](**values)(state, noise or {})
    return found


def clear_state(picture: Tensor, depth_m: float | Tensor = 20.0, **more: Any) -> CameraState:
    """A frame ``(H, W)`` in clear air."""
    depth_map = depth_m if isinstance(depth_m, Tensor) else torch.full((1, H, W), depth_m)
    state = rain_in_fog(Fog(mor_m=inf)).state_of(picture.reshape(1, H, W).double(), depth_map)
    return state.changed(**more)


def fog_alpha() -> Array:
    """Extinction of the scene's fog for red, green, blue."""
    fog = rain_in_fog(Fog(mor_m=60.0)).chain.stages["extinction_and_airlight"]
    found: Array = fog.extinction_per_m(1)[0].double().numpy()
    return found


def foggy(name: str, seed: int = 3, **values: Any) -> tuple[Array, Array, Array, CameraState]:
    """Frame, length of the rays, result and last state of the scene in fog with an effect; sample 0."""
    transform = rain_in_fog(Fog(mor_m=60.0))
    chain = chain_with(transform, name, **values)
    state = begin(transform, dtype=torch.float64)
    after = chain(state, chain.draw(state, seed=seed))
    length_m = (state.scene.depth_m * state.scene.ray_per_depth)[0, 0].numpy()
    return state.image.signal[0, 0].numpy(), length_m, after.image.signal[0, 0].numpy(), after


# ---- what holds for all ------------------------------------------------------------------------------------------


def test_the_catalogue_is_complete_and_in_order() -> None:
    assert list(CATALOGUE) == CAMERA_EFFECTS
    assert {name: {p.name: p.identity for p in EFFECTS[name].arguments} for name in CAMERA_EFFECTS} == CATALOGUE


@every_effect
def test_an_effect_declares_itself(name: str) -> None:
    effect = EFFECTS[name]
    assert effect.after in CAMERA_PLACES
    assert effect.default_name == name.removeprefix("camera.")
    assert effect.__name__ == "Camera" + "".join(word.capitalize() for word in effect.default_name.split("_"))
    assert effect.title
    assert effect.term
    assert effect.axes
    assert set(effect.confusable_with) <= set(CAMERA_EFFECTS) - {name}
    assert all(len(separated_by) > 10 for separated_by in effect.confusable_with.values())
    for parameter in effect.arguments:
        assert parameter.low <= parameter.value <= parameter.high
        assert 0 < parameter.scale < math.inf
        with pytest.raises(ValueError, match=f"{effect.__name__}: {parameter.name} must lie in"):
            effect(**{parameter.name: parameter.low - 1.0})
    assert bool(effect().at_identity)
    assert not bool(active(name).at_identity)


def test_effects_stand_in_the_order_of_the_light_whatever_the_weather() -> None:
    scene = [
        "airlight_scale",
        "extinction_scale",
        "wind_slant",
        "wet_surface",
        "patchy_fog",
        "height_fog",
        "streak_contrast",
        "particle_count",
        "rolling_shutter",
        "snow_cover",
    ]
    lens = ["adherent_drops", "refracting_drops", "ego_blur", "defocus", "vignetting", "stray_light"]
    pixels = ["exposure_gain", "sensor_noise", "saturation", "tone_curve"]
    fog, veil = "extinction_and_airlight", "particle_veil"
    for weather, middle in (
        (Mixture(Rain(5.0), Fog(mor_m=60.0)), [fog, "aerosol_glow", "road_spray", veil]),
        (Fog(mor_m=60.0), [fog, "aerosol_glow", "road_spray"]),
        (Snow(1.0), ["aerosol_glow", "road_spray", veil]),
    ):
        effects = [EFFECTS[name]() for name in reversed(CAMERA_EFFECTS)]
        chain = rain_in_fog(weather, effects=effects).chain
        assert list(chain.stages) == [*scene, *middle, *lens, *pixels, "quantise"]


@every_effect
@pytest.mark.parametrize("weather", [Mixture(Rain(50.0), Fog(mor_m=60.0)), Fog(mor_m=60.0), Snow(2.0)], ids=str)
def test_at_identity_nothing_changes_bit_for_bit(name: str, weather: Any) -> None:
    transform = rain_in_fog(weather)
    with_effect = rain_in_fog(weather, effects=[EFFECTS[name]()])
    noise = with_effect.draw(frame(), seed=3)
    wanted = transform.run(frame(), depth(), noise)
    found = with_effect.run(frame(), depth(), noise, normal=normals())
    for field in ("bayer", "transmission", "airlight", "particle_mask"):
        assert torch.equal(getattr(found, field), getattr(wanted, field)), field


@every_effect
def test_a_sample_at_identity_stays_beside_one_that_is_not(name: str, plain: BayerWeather) -> None:
    values = {
        p.name: torch.tensor([p.value, ACTIVE[name][p.name], p.value])
        for p in EFFECTS[name].arguments
        if p.identity is not None
    }
    chain = with_effects(plain.chain, [active(name, **values)])
    state = begin(plain)
    noise = chain.draw(state, seed=3)
    wanted, found = plain.chain(state, noise).image.signal, chain(state, noise).image.signal
    for sample in (0, 2):
        assert torch.equal(found[sample], wanted[sample])
    assert not torch.equal(found[1], wanted[1])


def spread(name: str, batch: int = 3) -> dict[str, Tensor]:
    """A parameter of its own for each sample, towards the middle of what is allowed."""
    return {
        key: torch.tensor([value * (1.0 - 0.125 * row) for row in range(batch)]) for key, value in ACTIVE[name].items()
    }


@every_effect
def test_a_batch_with_parameters_of_its_own_equals_its_samples(name: str, plain: BayerWeather) -> None:
    values, state = spread(name), begin(plain)
    chain = chain_with(plain, name, **values)
    noise = chain.draw(state, seed=3)
    together = chain(state, noise).image.signal
    for row in range(3):
        one = plain.state_of(frame()[row : row + 1], depth()[row : row + 1], normals())
        single = chain_with(plain, name, **{key: float(value[row]) for key, value in values.items()})
        found = single(one, {key: value[row : row + 1] for key, value in noise.items()}).image.signal
        # Fused multiplications differ with the shape: a few roundings of single precision.
        torch.testing.assert_close(found[0], together[row], rtol=1e-5, atol=2e-6)


@every_effect
def test_the_same_seed_gives_the_same_and_noise_has_the_streams_that_the_effect_names(
    name: str, plain: BayerWeather
) -> None:
    state, chain = begin(plain), with_effects(plain.chain, [active(name)])
    once, again, other = (chain(state, chain.draw(state, seed=seed)).image.signal for seed in (3, 3, 8))
    assert torch.equal(once, again)
    assert not torch.equal(once, other)
    own = f"{EFFECTS[name].default_name}."
    drawn = {key.removeprefix(own) for key in chain.draw(state, seed=3) if key.startswith(own)}
    assert drawn == {variate.name for variate in active(name).variates()}


@every_effect
def test_an_effect_comes_back_from_its_dictionary_and_its_chain_from_a_file(
    name: str, plain: BayerWeather, tmp_path: Path
) -> None:
    effect = EFFECTS[name](**spread(name))
    again = effect_from_dict(yaml.safe_load(yaml.safe_dump(effect.to_dict())))
    assert type(again) is type(effect)
    chain = with_effects(plain.chain, [again])
    chain.save(tmp_path / "chain.zip")
    loaded, state = Chain.load(tmp_path / "chain.zip"), begin(plain)
    noise = chain.draw(state, seed=3)
    assert torch.equal(
        loaded(state, noise).image.signal, with_effects(plain.chain, [effect])(state, noise).image.signal
    )


# Parameters on which the frame depends smoothly, with a step for differences.
SMOOTH = {
    "camera.exposure_gain": {"factor": 2.0**-7},
    "camera.airlight_scale": {"red": 2.0**-7, "green": 2.0**-7, "blue": 2.0**-9},
    "camera.extinction_scale": {"factor": 2.0**-7, "wavelength_exponent": 2.0**-7},
    "camera.stray_light": {"offset": 2.0**-9, "share": 2.0**-9},
    "camera.aerosol_glow": {"share_per_optical_depth": 2.0**-9, "width_px_per_optical_depth": 2.0**-9},
    "camera.defocus": {"radius_px": 2.0**-9},
    "camera.ego_blur": {"length_px": 2.0**-9, "angle_rad": 2.0**-9},
    "camera.adherent_drops": {"cover": 2.0**-10},
    "camera.vignetting": {"strength": 2.0**-7},
    "camera.wind_slant": {"angle_rad": 2.0**-8},
    "camera.wet_surface": {"darkening": 2.0**-7, "mirror": 2.0**-7},
    "camera.sensor_noise": {"electrons_per_unit": 2.0, "read_electrons": 2.0**-4},
    "camera.tone_curve": {"gamma": 2.0**-8},
    "camera.saturation": {"level": 2.0**-14},
    "camera.patchy_fog": {"log_std": 2.0**-8},
    "camera.height_fog": {"scale_height_m": 2.0**-6},
    "camera.streak_contrast": {"factor": 2.0**-7},
}
# In single precision and through the corners of streaks; through the rims of drops.
ROUGH = {"camera.wind_slant", "camera.adherent_drops"}


@pytest.mark.parametrize(("name", "key"), [(name, key) for name, keys in SMOOTH.items() for key in keys])
def test_gradients_are_those_of_finite_differences(name: str, key: str, plain: BayerWeather) -> None:
    state = begin(plain, batch=1, dtype=torch.float64)
    noise = with_effects(plain.chain, [active(name)]).draw(state, seed=3)
    weight = torch.linspace(0.5, 1.5, H * W, dtype=torch.float64).reshape(H, W) * torch.cos(torch.arange(W) / 5.0)

    def response(value: Any) -> Tensor:
        after = with_effects(plain.chain, [active(name, **{key: value})])(state, noise)
        total: Tensor = (weight * after.image.signal).sum()
        return total

    at, step = ACTIVE[name][key], SMOOTH[name][key]
    parameter = torch.tensor(at, requires_grad=True)
    response(parameter).backward()
    assert parameter.grad is not None
    slope = float(response(at + step) - response(at - step)) / (2.0 * step)
    assert slope != 0.0
    assert float(parameter.grad) == pytest.approx(slope, rel=0.1 if name in ROUGH else 5e-3)


def test_a_gradient_reaches_the_parameters_of_each_sample() -> None:
    factor = torch.tensor([1.0, 0.5, 0.25], requires_grad=True)
    transform = rain_in_fog(effects=[EFFECTS["camera.exposure_gain"](factor=factor)])
    transform(frame(), depth(), transform.draw(frame(), seed=1)).sum().backward()
    assert factor.grad is not None
    assert (factor.grad > 0).all()


def test_the_gradient_of_a_row_s_time_is_that_of_finite_differences() -> None:
    transform = rain_in_fog(Rain(50.0))
    state = transform.state_of(frame(1), torch.full((1, H, W), 50.0))
    veil = transform.chain.stages["particle_veil"]
    noise, part = veil.draw(state, seed=3), veil.parts[0]
    weight = torch.linspace(0.5, 1.5, H * W, dtype=torch.float64).reshape(H, W)

    def response(row_time_s: Tensor) -> Tensor:
        moved = state.changed(row_time_s=row_time_s.reshape(1))
        total: Tensor = (weight * part.listed_depth(moved, noise, part.at_rate(1))[0].double()).sum()
        return total

    at, step = 1e-4, 4e-6
    parameter = torch.tensor(at, requires_grad=True)
    response(parameter).backward()
    assert parameter.grad is not None
    slope = float(response(torch.tensor(at + step)) - response(torch.tensor(at - step))) / (2.0 * step)
    assert float(parameter.grad) == pytest.approx(slope, rel=0.01)


def test_a_count_has_a_gradient_where_no_particle_joins() -> None:
    """The haze's mean is a line in the count; listed particles grow with it."""
    factor = torch.tensor(0.5, requires_grad=True)
    transform = rain_in_fog(Rain(50.0), effects=[EFFECTS["camera.particle_count"](factor=factor)])
    transform.run(frame(), depth(), transform.draw(frame(), seed=1)).particle_mask.sum().backward()
    assert factor.grad is not None
    assert float(factor.grad) > 0


# ---- light and pixels --------------------------------------------------------------------------------------------


def test_exposure_gain_multiplies_every_signal_up_to_saturation() -> None:
    picture = frame(1)[0, 0]
    for factor in (0.5, 2.0):
        found = alone("camera.exposure_gain", clear_state(picture), factor=factor).image.signal[0, 0].numpy()
        np.testing.assert_allclose(found, np.minimum(factor * picture.numpy(), 1.0), rtol=1e-6)


def test_stray_light_adds_the_offset_and_a_share_of_each_colours_mean() -> None:
    picture, colour = frame(1)[0, 0].double().numpy(), colour_of().numpy()
    found = alone("camera.stray_light", clear_state(frame(1)), offset=0.03, share=0.2).image.signal[0, 0].numpy()
    for which in range(3):
        own = colour == which
        wanted = np.minimum(picture[own] + 0.03 + 0.2 * picture[own].mean(), 1.0)
        np.testing.assert_allclose(found[own], wanted, rtol=1e-5)


@pytest.mark.parametrize("strength", [1.0, 2.5])
def test_vignetting_is_a_power_of_the_cosine_to_the_fourth(strength: float) -> None:
    found = (
        alone("camera.vignetting", clear_state(torch.full((H, W), 0.5)), strength=strength).image.signal[0, 0].numpy()
    )
    row, column = np.mgrid[:H, :W]
    radius_px = np.hypot(row - (H - 1) / 2, column - (W - 1) / 2)
    np.testing.assert_allclose(found, 0.5 * np.cos(np.arctan(radius_px / FOCAL_PX)) ** (4.0 * strength), rtol=1e-5)


def test_the_variance_of_the_noise_is_a_line_in_the_mean() -> None:
    electrons, read = 200.0, 6.0
    picture = torch.linspace(0.1, 0.8, W).expand(H, W)
    state, effect = clear_state(picture), active("camera.sensor_noise")
    draws = [effect.draw(state, seed=seed)["electrons"] for seed in range(60)]
    values = {"electrons_per_unit": electrons, "read_electrons": read}
    frames = np.stack(
        [
            alone("camera.sensor_noise", state, {"electrons": draw}, **values).image.signal[0, 0].numpy()
            for draw in draws
        ]
    )
    variance = frames.reshape(-1, W).var(0)  # of 60 x 32 draws: 3 % each
    wanted = picture[0].numpy() / electrons + (read / electrons) ** 2
    np.testing.assert_allclose(variance[5:-5], wanted[5:-5], rtol=0.15)
    slope, intercept = np.polyfit(picture[0].numpy(), variance, 1)
    assert slope == pytest.approx(1.0 / electrons, rel=0.1)
    assert intercept == pytest.approx((read / electrons) ** 2, rel=0.6)


def test_saturation_cuts_and_a_tone_curve_bends() -> None:
    picture = frame(1)[0, 0]
    cut = alone("camera.saturation", clear_state(picture), level=0.4).image.signal[0, 0].numpy()
    np.testing.assert_array_equal(cut, np.minimum(picture.numpy(), np.float32(0.4)))
    picture[0, :2] = torch.tensor([0.0, 1.0])
    curved = alone("camera.tone_curve", clear_state(picture), gamma=0.45).image.signal[0, 0].numpy()
    np.testing.assert_allclose(curved, picture.double().numpy() ** 0.45, rtol=1e-5)


# ---- blurs -------------------------------------------------------------------------------------------------------


def impulse(row: int = 16, column: int = 24) -> Tensor:
    picture = torch.zeros(H, W, dtype=torch.float64)
    picture[row, column] = 1.0
    return picture


def moments(found: Array, row: int = 16, column: int = 24) -> tuple[float, Array]:
    """Sum, and second moments (column-column, row-row, column-row) around a pixel."""
    v, u = np.mgrid[:H, :W]
    u, v = u - column, v - row
    return float(found.sum()), np.array([(found * one).sum() for one in (u * u, v * v, u * v)])


@pytest.mark.parametrize("radius_px", [0.5, 1.5, 4.0, 9.0])
def test_defocus_has_the_variance_of_its_disk_and_stays_in_the_colour(radius_px: float) -> None:
    picture = 0.3 + 0.6 * impulse()
    found = alone("camera.defocus", clear_state(picture), radius_px=radius_px).image.signal[0, 0].double().numpy()
    total, second = moments((found - 0.3) / 0.6)
    assert total == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(second, np.array([1.0, 1.0, 0.0]) * radius_px**2 / 4, rtol=1e-3, atol=1e-6)
    for other in (found[1::2], found[:, 1::2]):
        np.testing.assert_allclose(other, 0.3, atol=1e-6)


def test_a_wide_defocus_is_an_even_disk() -> None:
    radius_px = 9.0
    picture = 0.3 + 0.6 * impulse()
    found = alone("camera.defocus", clear_state(picture), radius_px=radius_px).image.signal[0, 0].double().numpy()
    row, column = np.mgrid[:H, :W]
    away_px = np.hypot(row - 16, column - 24)
    same = (row % 2 == 0) & (column % 2 == 0)
    even = 0.3 + 0.6 * 4.0 / (math.pi * radius_px**2)  # a pixel of a colour stands for 4 px^2
    np.testing.assert_allclose(found[same & (away_px < radius_px - 2.5)], even, rtol=0.01)
    np.testing.assert_allclose(found[same & (away_px > radius_px + 4.0)], 0.3, atol=1e-5)


@pytest.mark.parametrize("radius_px", [0.25, 1.0, 3.0, 8.0])
def test_defocus_of_a_parabola_adds_exactly_the_variance_of_the_disk(radius_px: float) -> None:
    """The mean of 0.2 + u^2 c over a disk around u is that at u plus c radius^2 / 4."""
    u = torch.arange(W, dtype=torch.float64) - (W - 1) / 2
    curve = 1e-3
    picture = (0.2 + curve * u.square()).expand(H, W)
    found = alone("camera.defocus", clear_state(picture), radius_px=radius_px).image.signal[0, 0]
    inner = slice(14, W - 14)  # away from the edges
    wanted = picture[8:-8, inner] + curve * radius_px**2 / 4
    torch.testing.assert_close(found[8:-8, inner], wanted, rtol=0.0, atol=1e-6 + 2e-3 * curve * radius_px**2 / 4)


@pytest.mark.parametrize(("length_px", "angle_rad"), [(1.0, 0.3), (5.0, 0.0), (8.0, 0.7), (8.0, math.pi / 2)])
def test_ego_blur_of_parabolas_adds_the_variance_of_its_line_along_it_alone(length_px: float, angle_rad: float) -> None:
    row, column = torch.meshgrid(torch.arange(H).double() - 15.5, torch.arange(W).double() - 23.5, indexing="ij")
    along = column * math.cos(angle_rad) + row * math.sin(angle_rad)
    across = row * math.cos(angle_rad) - column * math.sin(angle_rad)
    curve, inner = 5e-4, (slice(10, -10), slice(12, -12))
    for place, more in ((along, length_px**2 / 12), (across, 0.0)):
        picture = 0.1 + curve * place.square()
        found = alone("camera.ego_blur", clear_state(picture), length_px=length_px, angle_rad=angle_rad).image.signal[
            0, 0
        ]
        # The line has 65 points: 1 in 65^2 less.
        torch.testing.assert_close(found[inner], (picture + curve * more)[inner], rtol=0.0, atol=1e-6)


def test_aerosol_glow_spreads_a_share_of_the_light_over_the_optical_depth_s_width() -> None:
    """An impulse seen by an even depth: what is taken from it lies around it with the wanted variance."""
    share, width, tau = 0.7, 2.0, 1.3
    alpha = torch.full((1, 3), tau / 20.0)
    state = clear_state(0.9 * impulse(), 20.0, fog_extinction_per_m=alpha, ray_per_depth=torch.ones(1, 1, H, W))
    values = {"share_per_optical_depth": share, "width_px_per_optical_depth": width}
    found = alone("camera.aerosol_glow", state, **values).image.signal[0, 0].double().numpy() / 0.9
    total, second = moments(found)
    assert total == pytest.approx(1.0, abs=1e-4)
    moved = 1.0 - math.exp(-share * tau)
    np.testing.assert_allclose(second, moved * (width * tau) ** 2 * np.array([1.0, 1.0, 0.0]), rtol=5e-3, atol=1e-4)
    assert not found[1::2].any()


def test_aerosol_glow_softens_what_is_far_and_leaves_what_is_near_and_even_light() -> None:
    transform = rain_in_fog(Fog(mor_m=60.0))
    depth_m = torch.full((1, H, W), 1.0)
    depth_m[..., W // 2 :] = 40.0
    stripes = (0.1 + 0.6 * ((torch.arange(W) // 2) % 2)).expand(1, H, W)
    chain = chain_with(transform, "camera.aerosol_glow", share_per_optical_depth=1.0, width_px_per_optical_depth=4.0)
    state = transform.state_of(stripes, depth_m)
    before, after = transform.chain(state, {}).image.signal[0, 0], chain(state, {}).image.signal[0, 0]
    contrast = [
        float(one[::2, part].diff(dim=1).abs().mean())
        for part in (slice(0, 20, 2), slice(30, W, 2))
        for one in (before, after)
    ]
    assert contrast[1] / contrast[0] > 0.9
    assert contrast[3] / contrast[2] < 0.2
    even = clear_state(
        torch.full((H, W), 0.4), torch.rand(1, H, W) * 40.0, fog_extinction_per_m=torch.full((1, 3), 0.05)
    )
    found = alone("camera.aerosol_glow", even, share_per_optical_depth=1.0, width_px_per_optical_depth=9.0).image.signal
    torch.testing.assert_close(found, even.image.signal, rtol=1e-5, atol=0.0)


def test_adherent_drops_show_the_mean_of_the_scene_under_soft_disks() -> None:
    cover, picture = 0.3, frame(1)[0, 0].double().numpy()
    effect = EFFECTS["camera.adherent_drops"](cover=cover)
    state = clear_state(frame(1))
    noise = effect.draw(state, seed=4)
    found = effect(state, noise).image.signal[0, 0].numpy()
    drops = noise["drops"][0].double().numpy()
    areas = 4.0 ** drops[:, 2]
    areas *= -math.log(1.0 - cover) * H * W / areas.sum()
    clear = np.ones((H, W))
    for (u, v, _), area in zip(drops, areas, strict=True):
        radius = math.sqrt(area / math.pi / (13.0 / 12.0))
        for row in range(H):
            for column in range(W):
                aside = min(abs(column - u * W + turn * W) for turn in (-1, 0, 1))
                along = min(abs(row - v * H + turn * H) for turn in (-1, 0, 1))
                clear[row, column] *= 1.0 - min(max(1.5 - math.hypot(aside, along) / radius, 0.0), 1.0)
    colour = colour_of().numpy()
    mean = np.array([picture[colour == which].mean() for which in range(3)])[colour]
    np.testing.assert_allclose(found, clear * picture + (1.0 - clear) * mean, atol=2e-6)


def test_drops_hide_the_cover_on_average() -> None:
    effect, state = CameraAdherentDrops(cover=0.3), clear_state(frame(1))
    masks = [float(effect.mask(state, effect.draw(state, seed=seed)["drops"]).mean()) for seed in range(200)]
    # Of drops anywhere: their standard error, and the 24 disks against infinitely many.
    assert np.mean(masks) == pytest.approx(0.3, abs=3.0 * np.std(masks) / math.sqrt(200) + 0.005)


# ---- air ---------------------------------------------------------------------------------------------------------


def test_airlight_scales_what_fog_adds_and_not_what_it_lets_through() -> None:
    picture, length_m, found, after = foggy("camera.airlight_scale", red=0.5, green=0.9, blue=1.2)
    colour = colour_of().numpy()
    through = np.exp(-fog_alpha()[colour] * length_m)
    light = (np.array(LIGHT) * [0.5, 0.9, 1.2])[colour]
    np.testing.assert_allclose(found, picture * through + light * (1.0 - through), rtol=1e-5)
    assert after.air.airlight is not None
    np.testing.assert_allclose(after.air.airlight[0].numpy(), np.array(LIGHT) * [0.5, 0.9, 1.2], rtol=1e-6)


def test_airlight_above_saturation_is_saturation_and_the_result_says_so() -> None:
    transform = rain_in_fog(Snow(2.0), effects=[active("camera.airlight_scale", red=5.0)])
    result = transform.run(frame(), depth(), transform.draw(frame(), seed=1))
    assert result.airlight[0].tolist() == pytest.approx([1.0, 0.75 * LIGHT[1], 1.125 * LIGHT[2]])


def test_extinction_scale_turns_the_slope_of_the_contrast_and_the_colours_apart() -> None:
    picture, length_m, found, _ = foggy("camera.extinction_scale", factor=1.6, wavelength_exponent=1.5)
    colour = colour_of().numpy()
    relative = np.array([600.0, 530.0, 460.0]) / 550.0
    alpha = fog_alpha() * 1.6 * relative**-1.5
    through = np.exp(-alpha[colour] * length_m)
    np.testing.assert_allclose(found, picture * through + np.array(LIGHT)[colour] * (1.0 - through), rtol=1e-5)
    seen = np.isfinite(length_m) & (length_m < 40.0) & (colour == 2)
    contrast = np.log((found - LIGHT[2])[seen] / (picture - LIGHT[2])[seen])
    assert np.polyfit(length_m[seen], contrast, 1)[0] == pytest.approx(-alpha[2], rel=1e-3)


def test_height_fog_is_the_integral_of_its_density_along_the_ray() -> None:
    scale_m, pitch = 3.0, 0.2
    own = camera(pitch_rad=pitch)
    transform = rain_in_fog(Fog(mor_m=60.0), own_camera=own)
    state = begin(transform, dtype=torch.float64)
    after = alone("camera.height_fog", state, scale_height_m=scale_m)
    assert after.air.fog_density is not None
    for row, column in ((0, 5), (9, 40), (20, 3), (31, 24)):
        y, x = (row - (H - 1) / 2) / FOCAL_PX, (column - (W - 1) / 2) / FOCAL_PX
        length = math.sqrt(1.0 + x * x + y * y)
        # The ray turned up by the pitch, height in metres per metre of ray.
        rise = (math.sin(pitch) - y * math.cos(pitch)) / length
        far_m = min(float(state.scene.depth_m[0, 0, row, column]) * length, 3e3)
        place_m = np.linspace(0.0, far_m, 200_001)
        wanted = np.trapezoid(np.exp(-rise * place_m / scale_m), place_m)
        depth_m = float(state.scene.depth_m[0, 0, row, column].clamp_max(1e12)) * length
        assert float(after.air.fog_density[0, 0, row, column]) * depth_m == pytest.approx(wanted, rel=2e-3)


def test_patches_have_mean_one_a_log_normal_spread_near_by_and_less_of_it_far_away() -> None:
    log_std = 0.5
    effect = EFFECTS["camera.patchy_fog"](log_std=log_std)
    near, far = clear_state(frame(1), 15.0), clear_state(frame(1), 300.0)
    draws = [effect.draw(near, seed=seed) for seed in range(300)]
    density = [np.stack([effect(state, draw).air.fog_density[0, 0].numpy() for draw in draws]) for state in (near, far)]
    # 300 draws of about 24 banks: some percent.
    assert density[0].mean() == pytest.approx(1.0, abs=0.03)
    assert density[1].mean() == pytest.approx(1.0, abs=0.03)
    assert np.log(density[0]).std() == pytest.approx(log_std, rel=0.05)
    assert np.log(density[0]).mean() == pytest.approx(-(log_std**2) / 2, abs=0.04)
    length_m = 300.0 * float(far.scene.ray_per_depth.mean())
    parts_m = np.diff([0.0, 20.0, 40.0, 80.0, 160.0, min(length_m, 320.0)])
    wanted = math.sqrt((math.exp(log_std**2) - 1.0) * ((parts_m / length_m) ** 2).sum())
    assert density[1].std() == pytest.approx(wanted, rel=0.06)


def test_the_fog_of_a_density_is_the_weather_s_extinction_times_it() -> None:
    picture, length_m, found, after = foggy("camera.patchy_fog", log_std=0.7)
    assert after.air.fog_density is not None
    density, colour = after.air.fog_density[0, 0].numpy(), colour_of().numpy()
    assert density.std() > 0.1
    with np.errstate(invalid="ignore"):
        through = np.exp(-fog_alpha()[colour] * np.minimum(length_m, 1e9) * density)
    np.testing.assert_allclose(found, picture * through + np.array(LIGHT)[colour] * (1.0 - through), rtol=1e-5)


def fresnel_reflectance(cosine: float, index: float = 1.33) -> float:
    """Of unpolarised light, from the angles (Fresnel's sine and tangent formulas)."""
    angle = math.acos(cosine)
    refracted = math.asin(math.sin(angle) / index)
    sine = math.sin(angle - refracted) / math.sin(angle + refracted)
    tangent = math.tan(angle - refracted) / math.tan(angle + refracted)
    return 0.5 * (sine**2 + tangent**2)


def test_a_wet_road_is_darker_and_mirrors_the_picture_above_the_horizon() -> None:
    darkening, mirror = 0.4, 0.8
    row = torch.arange(H, dtype=torch.float64)[:, None].expand(H, W)
    picture = 0.8 - 0.015 * row  # a line in the row, which interpolation keeps
    state = clear_state(picture, normal=normals()[None])
    found = alone("camera.wet_surface", state, darkening=darkening, mirror=mirror).image.signal[0, 0]
    torch.testing.assert_close(found[: H // 2], picture[: H // 2], rtol=1e-6, atol=0.0)
    for v in range(H // 2 + 1, H - 2):
        for u in (4, 23, 40):
            y, x = (v - (H - 1) / 2) / FOCAL_PX, (u - (W - 1) / 2) / FOCAL_PX
            share = mirror * fresnel_reflectance(y / math.sqrt(1.0 + x * x + y * y))
            own = float(picture[v, u]) * (1.0 - darkening)
            # A level mirror turns the row about the horizon.
            wanted = own * (1.0 - share) + share * (0.8 - 0.015 * (H - 1 - v))
            assert float(found[v, u]) == pytest.approx(wanted, abs=1e-5), (v, u)


def test_a_wet_road_needs_normals() -> None:
    with pytest.raises(ValueError, match="CameraWetSurface: expected a state with normal; this one has none"):
        rain_in_fog(effects=[active("camera.wet_surface")])(frame(), depth())
    with pytest.raises(ValueError, match=r"normal must be a tensor \(..., 3, 32, 48\)"):
        rain_in_fog(effects=[active("camera.wet_surface")])(frame(), depth(), normal=torch.zeros(1, H, W))


# ---- particles ---------------------------------------------------------------------------------------------------


def rain_only(**more: Any) -> BayerWeather:
    return rain_in_fog(Rain(50.0), **more)


def marks_of(transform: BayerWeather, seed: int = 2, **fields: Tensor) -> Marks:
    """All listed particles of a draw, sample 0."""
    state = transform.state_of(frame(1), depth(1)).changed(**fields)
    veil = transform.chain.stages["particle_veil"]
    assert isinstance(veil, ParticleVeil)
    part = veil.parts[0]
    noise = veil.draw(state, seed=seed)
    tables = part.at_rate(1, state.air.particle_count)
    portions = [m for number in range(len(part.tables.listed)) for m in part.marks(state, noise, tables, number)]

    def join(name: str) -> Tensor:
        return torch.cat([getattr(marks, name)[marks.opacity > 0] for marks in portions])

    aside = None if portions[0].motion_u_px is None else join("motion_u_px")
    names = ("u_px", "v_px", "motion_v_px", "width_px", "opacity", "depth_m")
    return Marks(sample=None, motion_u_px=aside, **{name: join(name) for name in names})


def masks(seeds: int, depth_m: Tensor | None = None, **values: Any) -> Array:
    transform = rain_only(**values)
    depth_m = depth(1) if depth_m is None else depth_m
    found = [
        transform.run(frame(1), depth_m, transform.draw(frame(1), seed=s)).particle_mask[0, 0] for s in range(seeds)
    ]
    return np.stack([one.double().numpy() for one in found])


@pytest.mark.parametrize("angle_rad", [0.4, -0.7])
def test_wind_leans_every_streak_by_the_angle_and_leaves_its_fall(angle_rad: float) -> None:
    upright = marks_of(rain_only())
    slanted = marks_of(rain_only(), path_tangent=torch.tensor([math.tan(angle_rad)]))
    assert slanted.motion_u_px is not None
    assert len(slanted) > 20
    lean = np.arctan2(slanted.motion_u_px.numpy(), slanted.motion_v_px.numpy())
    np.testing.assert_allclose(lean, angle_rad, atol=1e-5)
    torch.testing.assert_close(slanted.motion_v_px, upright.motion_v_px)


def test_wind_leaves_the_share_of_light_that_drops_take() -> None:
    still, blown = (masks(40, effects=effects) for effects in ((), [active("camera.wind_slant")]))
    assert blown.mean() == pytest.approx(still.mean(), rel=0.03)
    assert np.abs(blown - still).max() > 0.01


def test_wind_blows_to_the_right_of_a_rolled_camera_s_vehicle() -> None:
    """A camera on its side sees drops fall along its columns' normal, and wind along the columns."""
    rolled = rain_only(own_camera=camera(roll_rad=math.pi / 2))
    still, blown = marks_of(rolled), marks_of(rolled, path_tangent=torch.tensor([0.5]))
    assert still.motion_u_px is not None
    assert blown.motion_u_px is not None
    torch.testing.assert_close(blown.motion_u_px, still.motion_u_px, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(
        (blown.motion_v_px - still.motion_v_px).abs(), 0.5 * still.motion_u_px.abs(), rtol=1e-3, atol=1e-3
    )


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.5])
def test_streak_contrast_scales_what_particles_change(factor: float, plain: BayerWeather) -> None:
    transform = rain_only()
    state = begin(transform)
    chain = chain_with(transform, "camera.streak_contrast", factor=factor)
    noise = chain.draw(state, seed=3)
    change = (transform.chain(state, noise).image.signal - state.image.signal).numpy()
    found = chain(state, noise).image.signal.numpy()
    np.testing.assert_allclose(found, np.clip(state.image.signal.numpy() + factor * change, 0.0, 1.0), atol=2e-6)
    assert np.abs(change).max() > 0.01


@pytest.mark.parametrize("factor", [0.5, 3.0, 8.0])
def test_the_optical_depth_of_the_veil_grows_with_the_count(factor: float) -> None:
    effect = EFFECTS["camera.particle_count"](factor=factor)
    plain_depth, scaled = (-np.log1p(-masks(60, effects=effects)).mean() for effects in ((), [effect]))
    # The 60 draws share their particles where they can.
    assert scaled / plain_depth == pytest.approx(factor, rel=0.06)


def test_more_particles_than_slots_are_of_the_same_sizes_and_depths() -> None:
    """Eight times as many at 50 mm/h, for which the draw has no slots: from displaced copies."""
    transform = rain_only()
    few = [marks_of(transform, seed) for seed in range(30)]
    many = [marks_of(transform, seed, particle_count=torch.tensor([8.0])) for seed in range(30)]
    number = sum(map(len, few))
    assert sum(map(len, many)) / number == pytest.approx(8.0, abs=8.0 * 3.0 / math.sqrt(number))
    for name in ("depth_m", "width_px", "u_px", "v_px"):
        own, other = (np.concatenate([getattr(one, name).numpy() for one in marks]) for marks in (few, many))
        ends = [np.quantile(one, [0.25, 0.5, 0.75]) for one in (own, other)]
        # Quantiles of a thousand particles.
        np.testing.assert_allclose(ends[1], ends[0], atol=0.1 * (ends[0][2] - ends[0][0]), err_msg=name)


def test_particles_that_end_at_a_depth_are_those_in_front_of_a_wall_there() -> None:
    ended = masks(3, effects=[EFFECTS["camera.particle_count"](depth_max_m=4.0)])
    walled = masks(3, depth_m=depth(1).clamp_max(4.0))
    np.testing.assert_allclose(ended, walled, atol=1e-6)
    assert masks(3).mean() > 1.1 * ended.mean()


def test_a_rolling_shutter_sees_what_a_moving_disk_does_to_each_row_in_its_time() -> None:
    """Rows exposed one after the other, integrated over time, against the mark that the stage makes of it."""
    exposure_s, row_s, speed_px_per_s, width, start = 0.01, 2e-4, 800.0, 1.2, 9.0
    part = rain_only().chain.stages["particle_veil"].parts[0]
    assert part.optics.exposure_s == exposure_s

    def one(value: float) -> Tensor:
        return torch.tensor([value])

    at_rest = Marks(None, one(24.0), one(start), None, one(speed_px_per_s * exposure_s), one(width), one(0.9), one(3.0))
    moved = part._row_by_row(at_rest, one(row_s))
    total, _ = add_listed(torch.zeros(H * W), None, moved, torch.full((H * W,), 100.0), (H, W))
    found = -torch.expm1(-total).view(H, W).sum(1).double().numpy()

    # Middle of row 0's exposure: the disk's centre is at `start`.
    time_s = (np.arange(20_000) + 0.5) / 20_000 * exposure_s - exposure_s / 2
    wanted = np.zeros(H)
    y = np.linspace(-width / 2, width / 2, 41)
    chord = np.sqrt(np.maximum(width**2 / 4 - y**2, 0.0))
    chord *= 0.9 * math.pi / 4 * width**2 / chord.sum()
    for row in range(H):
        centre = start + speed_px_per_s * (time_s + row * row_s)
        for offset, weight in zip(y, chord, strict=True):
            wanted[row] += weight * (np.abs(centre + offset - row) < 0.5).mean()
    assert wanted.sum() == pytest.approx(0.9 * math.pi / 4 * width**2 / (1.0 - speed_px_per_s * row_s), rel=1e-2)
    # Ends of the streak: the mark is a trapezoid, the disk is round.
    np.testing.assert_allclose(found, wanted, atol=0.1 * wanted.max())
    assert found.sum() == pytest.approx(wanted.sum(), rel=0.02)


def test_a_rolling_shutter_leaves_the_mean_cover() -> None:
    still, rolling = (masks(60, effects=effects) for effects in ((), [active("camera.rolling_shutter")]))
    assert rolling.mean() == pytest.approx(still.mean(), rel=0.05)


# ---- sequences, recipes, graphs, devices -------------------------------------------------------------------------


def test_in_a_sequence_noise_is_new_and_drops_on_the_window_stay() -> None:
    effects = [active(name) for name in ("camera.sensor_noise", "camera.adherent_drops", "camera.patchy_fog")]
    transform = rain_in_fog(effects=effects)
    first, second = transform.draw_sequence(frame(1), 2, 0.1, seed=3)
    assert not torch.equal(first["sensor_noise.electrons"], second["sensor_noise.electrons"])
    assert torch.equal(first["adherent_drops.drops"], second["adherent_drops.drops"])
    assert torch.equal(first["sensor_noise.electrons"], transform.draw(frame(1), seed=3)["sensor_noise.electrons"])


def test_a_transform_takes_effects_and_its_recipe_holds_them(tmp_path: Path) -> None:
    effects = [active("camera.sensor_noise"), {"effect": "camera.defocus", "radius_px": 2.0}]
    transform = BayerFog(Fog(mor_m=60.0), camera(), depth=20.0, airlight=LIGHT, effects=effects)
    assert list(transform.chain.stages) == ["extinction_and_airlight", "defocus", "sensor_noise", "quantise"]
    save_recipe(transform, tmp_path / "fog.yaml", title="fog through a soft lens")
    again = load_recipe(tmp_path / "fog.yaml")
    noise = transform.draw(frame(), seed=2)
    assert torch.equal(again(frame(), noise=noise), transform(frame(), noise=noise))


@pytest.mark.parametrize("make", [BayerRain, BayerSnow, BayerWeather])
def test_every_transform_takes_effects_and_a_raw_frame_comes_back_in_its_format(make: type[BayerWeather]) -> None:
    weather = Snow(1.0) if make is BayerSnow else Rain(5.0)
    transform = make(
        weather, camera(), depth=20.0, airlight=LIGHT, far_m=10.0, effects=[active("camera.exposure_gain")]
    )
    raw = (frame() * 4095).to(torch.uint16)
    found = transform(raw)
    assert found.dtype == torch.uint16
    assert float(found.float().mean()) == pytest.approx(0.75 * float(raw.float().mean()), rel=0.05)


def test_the_direct_way_of_fog_refuses_effects() -> None:
    transform = rain_in_fog(Fog(mor_m=60.0), effects=[active("camera.exposure_gain")])
    with pytest.raises(ValueError, match="out= is for fog alone"):
        transform(frame(), depth(), out=torch.empty_like(frame()))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.long  # half a minute of torch's own time each; the LiDAR's and the radar's run every time
@pytest.mark.parametrize("weather", ["fog", "rain"])
def test_effects_are_exported_with_the_chain(weather: str, tmp_path: Path) -> None:
    """Every effect that a graph can hold, at settings that show, at another size than the traced.

    Those of the particles with the rain, all others with the fog.
    """
    onnxruntime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    falling = {"camera.wind_slant", "camera.streak_contrast", "camera.particle_count"}
    names = [name for name in CAMERA_EFFECTS if name not in NOT_IN_A_GRAPH and (name in falling) == (weather == "rain")]
    effects = [active(name, **({"factor": 0.5} if name == "camera.particle_count" else {})) for name in names]
    made = Fog(mor_m=60.0) if weather == "fog" else Rain(25.0)
    own = camera()
    transform = BayerWeather(made, own, airlight=LIGHT, near_m=2.5, far_m=5.0, effects=effects)
    to_onnx(transform, tmp_path / "graph.onnx", height=24, width=40)
    session = onnxruntime.InferenceSession(tmp_path / "graph.onnx", providers=["CPUExecutionProvider"])
    feed = draw_feed(session, height=H, width=W, seed=5)
    intensity = {"mor_m": 60.0} if weather == "fog" else {"rate_mm_per_h": 25.0}
    inputs = {"fx": own.fx, "fy": own.fy, "cx": own.cx, "cy": own.cy}
    got = session.run(
        ["signal"],
        {
            "bayer": frame(1).numpy(),
            "depth": depth(1).numpy(),
            **{key: np.array(value, np.float32) for key, value in inputs.items()},
            **{key: np.full(1, value, np.float32) for key, value in intensity.items()},
            **feed,
        },
    )[0]
    wanted = transform(frame(1), depth(1), {key: torch.from_numpy(value) for key, value in feed.items()})
    # Rounding of single precision through blurs of some hundred terms.
    np.testing.assert_allclose(got, wanted.numpy(), atol=5e-5)


@pytest.mark.parametrize("name", sorted(NOT_IN_A_GRAPH))
def test_an_effect_that_cannot_be_exported_says_so(name: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    transform = BayerFog(Fog(mor_m=60.0), camera(), airlight=LIGHT, effects=[active(name)])
    with pytest.raises(Exception, match=NOT_IN_A_GRAPH[name]):
        to_onnx(transform, tmp_path / "graph.onnx", height=24, width=40)
    assert not list(tmp_path.iterdir())


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@every_effect
def test_effects_run_on_cuda(name: str) -> None:
    transform = rain_in_fog(effects=[active(name)])
    noise = transform.draw(frame(), seed=3)
    wanted = transform(frame(), depth(), noise, normal=normals())
    there = transform.to("cuda")
    cuda = {key: value.cuda() for key, value in noise.items()}
    got = there(frame().cuda(), depth().cuda(), cuda, normal=normals().cuda())
    # Roundings differ between devices; a particle at its limit may join or leave.
    assert float(torch.isclose(got.cpu(), wanted, rtol=1e-3, atol=1e-4).float().mean()) >= 1.0 - 1e-2
