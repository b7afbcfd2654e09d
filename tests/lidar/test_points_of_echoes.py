"""Points that go out: particles and second echoes, worked out for the beams that have them, are those of all beams."""

from __future__ import annotations

import pytest
import torch

from tests.fake_trace import as_exported
from tests.lidar.effects.effect_scene import cloud, directions, own_noise, scan_sensor, states
from torchweather.atmosphere.weather import Snow
from torchweather.transforms import LidarSnow


def dual(**more: object) -> LidarSnow:
    return LidarSnow(Snow(2.0), scan_sensor(return_mode="dual", **more))


@pytest.mark.parametrize("range_noise_m", [0.0, 0.03])
@pytest.mark.parametrize("unit", ["reflectivity", "uint8_calibrated", "photons", "none"])
def test_points_of_some_beams_are_those_of_all(unit: str, range_noise_m: float) -> None:
    """An exported graph, which knows no rows, works out every beam."""
    transform = dual(intensity_unit=unit, range_noise_m=range_noise_m)
    points = cloud()
    if unit == "uint8_calibrated":
        points[..., 3] = (255.0 * points[..., 3]).round()
    state, stage = transform.state_of(points, directions()), transform.chain.stages["to_points"]
    noise = transform.chain.draw(state, seed=3)
    before, own = states(transform.chain, state, noise)["detection"], own_noise(noise, "to_points")
    found = stage(before, own).returns
    with as_exported():
        wanted = stage(before, own).returns
    kinds = before.returns.kind
    assert int((kinds[..., 0] == 1).sum()) > 20
    assert 5 < int((kinds[..., 1] != 2).sum()) < 0.5 * kinds[..., 1].numel()
    # Logarithms of a few numbers and of many may differ by a rounding on some processors.
    torch.testing.assert_close(found.points, wanted.points, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(found.second, wanted.second, rtol=1e-6, atol=1e-6)


def test_a_call_draws_what_draw_gives_and_refuses_what_it_refuses() -> None:
    transform, points = dual(), cloud()
    wanted = transform.run(points, transform.draw(points, seed=4))
    found = transform.run(points, seed=4)
    assert torch.equal(found.points, wanted.points)  # type: ignore[arg-type]
    assert torch.equal(found.second, wanted.second)  # type: ignore[arg-type]
    points[1, 7, 0] = torch.nan
    with pytest.raises(ValueError, match="points must be finite; got 1 rows"):
        transform(points, seed=4)
    points[1, 7, 0] = 2e9
    with pytest.raises(ValueError, match="coordinates must be metres; got 2e"):
        transform(points, seed=4)
