"""What a call draws by itself: seed and generator, a rate from a range, clear samples beside those in weather."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

import torchweather as tw
from tests.camera.effects import camera_effect_scene
from tests.lidar.effects import effect_scene
from torchweather.export import to_onnx
from torchweather.pipeline.at_call import weather_at_call
from torchweather.stages import Quantise

RANGE, FIXED = tw.Rain(rate_mm_per_h=(5.0, 50.0)), tw.Rain(rate_mm_per_h=20.0)


def camera(weather: Any, **more: Any) -> Any:
    return camera_effect_scene.rain_in_fog(weather, depth=20.0, **more)


def lidar(weather: Any, **more: Any) -> Any:
    directions = effect_scene.directions()
    return tw.LidarWeather(weather, effect_scene.scan_sensor(directions=directions), **more)


def test_the_share_of_samples_in_weather_is_p() -> None:
    drawn = weather_at_call(RANGE, 0.3, (4000,), range(4000), "test")
    rate = drawn.intensity
    assert isinstance(rate, Tensor)
    wet = rate > 0
    # Binomial: 4000 samples, standard deviation 0.0072; four of them. Rates are uniform: mean 27.5, sd 13 / sqrt(1200).
    assert abs(float(wet.double().mean()) - 0.3) < 4 * 0.0072
    assert abs(float(rate[wet].mean()) - 27.5) < 4 * 13.0 / 1200**0.5
    assert 5.0 <= float(rate[wet].min()) < float(rate[wet].max()) <= 50.0


def test_parts_of_a_mixture_are_drawn_together_and_fog_clears_to_infinity() -> None:
    mixture = tw.Mixture(RANGE, tw.Fog(mor_m=(50.0, 500.0)))
    fog, rain = weather_at_call(mixture, 0.5, (64,), range(64), "test").parts
    assert isinstance(fog.intensity, Tensor)
    assert isinstance(rain.intensity, Tensor)
    assert torch.equal(fog.intensity.isinf(), rain.intensity == 0)
    assert fog.intensity.isinf().any()
    assert fog.intensity.isfinite().any()


def test_a_gradient_goes_to_a_rate_given_as_a_tensor() -> None:
    rate = torch.tensor(20.0, requires_grad=True)
    drawn = weather_at_call(tw.Rain(rate), 0.5, (8,), range(8), "test").intensity
    assert isinstance(drawn, Tensor)
    drawn.sum().backward()
    assert float(rate.grad) == float((drawn > 0).sum())  # type: ignore[arg-type]


# ---- what is refused -------------------------------------------------------------------------------------------------


def test_a_probability_beyond_one_is_refused() -> None:
    with pytest.raises(ValueError, match=r"LidarWeather: p must lie in 0..1"):
        lidar(FIXED, p=1.5)


def test_a_chain_that_was_changed_is_not_built_anew() -> None:
    transform = camera(FIXED, p=0.5)
    transform.chain = type(transform.chain)({**transform.chain.stages, "again": Quantise()})
    with pytest.raises(ValueError, match="cannot be built anew"):
        transform(camera_effect_scene.frame(), seed=1)


def test_a_change_after_the_first_call_is_noticed_too() -> None:
    transform = camera(FIXED, p=0.5)
    transform(camera_effect_scene.frame(), seed=1)
    with torch.no_grad():
        next(iter(transform.buffers())).add_(1.0)
    with pytest.raises(ValueError, match="cannot be built anew"):
        transform(camera_effect_scene.frame(), seed=1)


def test_a_field_that_a_batch_shares_is_not_drawn_for_each_sample() -> None:
    banks = tw.Rain(rate_mm_per_h=10.0, patch_log_std=tw.Uniform(0.1, 0.5))
    with pytest.raises(ValueError, match=r"rain.patch_log_std is one value for all samples of a batch"):
        weather_at_call(banks, 1.0, (3,), (1, 2, 3), "test")
    assert isinstance(weather_at_call(banks, 1.0, (), (1,), "test").patch_log_std, float)


def test_compose_has_the_probability_and_not_a_transform_in_it() -> None:
    with pytest.raises(ValueError, match=r"'points' has p=0.5 of its own.* Give p to Compose"):
        tw.Compose({"points": lidar(FIXED, p=0.5)})


def test_a_graph_always_has_weather(tmp_path: Any) -> None:
    with pytest.raises(ValueError, match=r"to_onnx: .*p=0.5"):
        to_onnx(lidar(FIXED, p=0.5), tmp_path / "graph.onnx")


def test_transforms_in_a_row_are_told_what_to_write_instead() -> None:
    several = [lidar(FIXED), lidar(tw.Fog(mor_m=50.0))]
    for given in (several, tuple(several), several[0]):
        with pytest.raises(TypeError, match=r"expected a dictionary .* Mixture\(Rain\(10\), Fog\(mor_m=200\)\)"):
            tw.Compose(given)
    with pytest.raises(TypeError, match="got LidarWeather, LidarWeather"):
        tw.Compose(*several)


def test_a_mixture_takes_a_list_and_fog_another_name() -> None:
    assert tw.Mixture([FIXED, tw.Fog(mor_m=50.0)]) == tw.Mixture(FIXED, tw.Fog(visibility_m=50.0))
    with pytest.raises(TypeError, match=r"Mixture: expected weathers.* got 3"):
        tw.Mixture([FIXED, 3])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="are one number, the visibility in metres"):
        tw.Fog(mor_m=50.0, visibility_m=60.0)
    with pytest.raises(ValueError, match=r"a pair \(low, high\)"):
        tw.Rain([1, 50])  # type: ignore[arg-type]
