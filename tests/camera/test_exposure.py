"""Control of the exposure (PHYSICS.md 10.6)."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Rain
from torchweather.camera.exposure import ExposureControl
from torchweather.core.errors import InputValueError
from torchweather.recipes import load_recipe, save_recipe
from torchweather.sensors import Camera
from torchweather.stages import EFFECTS
from torchweather.transforms import AsBayer, BayerFog, BayerRain

CAMERA = Camera.from_intrinsics(100.0, 100.0, 31.5, 23.5, 64, 48)
FOG: dict[str, Any] = {"weather": Fog(mor_m=30.0), "camera": CAMERA, "depth": 20.0, "airlight": 0.8}


def frames() -> Tensor:
    """Two raw frames of other brightness."""
    return torch.rand(2, 1, 48, 64, generator=torch.Generator().manual_seed(1)) * torch.tensor([0.3, 0.02]).view(
        2, 1, 1, 1
    )


def test_each_frame_gets_its_mean_back() -> None:
    clear = frames()
    foggy = BayerFog(**FOG)(clear)
    held = BayerFog(**FOG, exposure_control=ExposureControl(lowest_gain=0.01))(clear)
    assert (foggy.mean((1, 2, 3)) > 3 * clear.mean((1, 2, 3))).all()
    torch.testing.assert_close(held.mean((1, 2, 3)), clear.mean((1, 2, 3)), rtol=1e-5, atol=0)
    gain = (clear.mean((1, 2, 3)) / foggy.mean((1, 2, 3))).view(2, 1, 1, 1)
    torch.testing.assert_close(held, foggy * gain, rtol=1e-5, atol=0)  # one gain a frame, in linear light


def test_the_median_of_a_window_is_kept() -> None:
    clear = frames()[:1]
    clear[..., :24, :] = 0.9  # a bright sky outside of the window
    control = ExposureControl("median", window=(0.5, 0.0, 1.0, 1.0))
    held = BayerFog(**FOG, exposure_control=control)(clear)
    assert float(held[..., 24:, :].median()) == pytest.approx(float(clear[..., 24:, :].median()), rel=0.05)


def test_a_window_narrower_than_a_cell_takes_one() -> None:
    clear = frames()
    for window in ((0.5, 0.0, 0.51, 1.0), (0.99, 0.99, 1.0, 1.0), (0.0, 0.0, 0.01, 0.01)):
        held = BayerFog(**FOG, exposure_control=ExposureControl(window=window))(clear)
        assert bool(held.isfinite().all())


def test_the_gain_keeps_its_limits_and_a_target_needs_no_clear_frame() -> None:
    clear = frames()
    foggy = BayerFog(**FOG)(clear)
    limited = BayerFog(**FOG, exposure_control=ExposureControl(lowest_gain=0.5))(clear)
    torch.testing.assert_close(limited, foggy * 0.5, rtol=1e-6, atol=0)
    aimed = BayerFog(**FOG, exposure_control=ExposureControl(target=0.18))(clear)
    torch.testing.assert_close(aimed.mean((1, 2, 3)), torch.full((2,), 0.18), rtol=1e-5, atol=0)


def test_no_weather_gives_the_input_back_bit_for_bit() -> None:
    for control in ("mean", "median"):
        raw = torch.randint(0, 4096, (2, 1, 48, 64), generator=torch.Generator().manual_seed(2)).to(torch.uint16)
        clear = BayerFog(**{**FOG, "weather": Fog(mor_m=math.inf)}, exposure_control=control)
        assert torch.equal(clear(raw), raw)
        rgb = torch.randint(0, 256, (3, 48, 64), generator=torch.Generator().manual_seed(3), dtype=torch.uint8)
        dry = AsBayer(BayerRain(Rain(0.0), CAMERA, depth=20.0, airlight=0.8, exposure_control=control))
        assert torch.equal(dry(rgb), rgb)


def test_it_acts_before_noise_and_saturation() -> None:
    effects = [EFFECTS["camera.sensor_noise"](electrons_per_unit=1e4), EFFECTS["camera.saturation"](level=0.9)]
    chain = BayerFog(**FOG, exposure_control="mean", effects=effects).chain
    names = list(chain.stages)
    assert names.index("exposure_meter") == 0
    order = [names.index(name) for name in ("exposure_control", "sensor_noise", "saturation", "quantise")]
    assert order == sorted(order)


def test_a_recipe_keeps_it(tmp_path: Any) -> None:
    control = ExposureControl("median", window=(0.2, 0.0, 1.0, 1.0), lowest_gain=0.05)
    for given in ("mean", control):
        fog = BayerFog(**FOG, exposure_control=given)
        save_recipe(fog, tmp_path / "fog.yaml", title="fog")
        again: Any = load_recipe(tmp_path / "fog.yaml")
        assert torch.equal(again(frames()), fog(frames()))
        (tmp_path / "fog.yaml").unlink()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"exposure_control": "auto"}, "mean"),
        ({"exposure_control": {"window": (0.5, 0.0, 0.2, 1.0)}}, "window"),
        ({"exposure_control": {"target": 3.0}}, "target"),
        ({"exposure_control": {"lowest_gain": 0.0}}, "lowest_gain"),
    ],
)
def test_bad_controls_are_named(given: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputValueError, match=expected):
        BayerFog(**FOG, **given)


def test_a_control_without_a_meter_says_so() -> None:
    state = BayerFog(**FOG).state_of(frames())
    with pytest.raises(InputValueError, match="ExposureMeter"):
        ExposureControl()(state, {})
