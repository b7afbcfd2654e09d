"""Share of a LiDAR's beams into open air that return from particles, and what it would be with other near responses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from torchweather.core.arguments import check_arguments
from torchweather.lidar.stages import Extinction, ParticleReturns
from torchweather.lidar.transform import LidarWeather

__all__ = ["UNMEASURED", "OpenAirReturns", "open_air_returns", "open_air_share"]

# The range at which a response (R / R_full)^2 is full, metres, between which answers are stated (PHYSICS.md 10.13).
SLOW_M, FAST_M = 30.0, 10.0
UNMEASURED = (2.0, 10.0, 1.0)  # start, full and power that a sensor has where none was measured
LEAST_PERCENT = 0.01  # printed as "less than"


@dataclass(frozen=True)
class OpenAirReturns:
    """Share of the beams that meet nothing but air and return from particles.

    Args:
        share: with the sensor's own near response.
        slow, fast: with responses that are full from 30 m and from 10 m; ``None`` where the sensor states its own.
    """

    share: float
    slow: float | None = None
    fast: float | None = None

    def text(self) -> str:
        """One sentence.

        Example:
            >>> OpenAirReturns(0.031, 0.004, 0.05).text()
            'Of beams into open air 3.1 % return from particles; 0.4 % to 5 %, as the near response is not measured.'
        """
        text = f"Of beams into open air {_percent(self.share)} return from particles"
        if self.slow is None or self.fast is None:
            return f"{text}, with the near response that the sensor states."
        # The sensor's own response is one of those that may be.
        low, *_, high = sorted((self.slow, self.share, self.fast))
        return f"{text}; {_percent(low)} to {_percent(high)}, as the near response is not measured."


def open_air_returns(transform: LidarWeather) -> OpenAirReturns:
    """Share of beams into open air that return from particles, with the range that an unmeasured near response leaves.

    Nothing decides LiDAR weather as much as the response between the sensor and some 30 m, and nothing is as little
    known (``PHYSICS.md`` 10.13). One sensor was measured, an OS2: ``(R / 30 m)^2``. For the others the shares with
    ``(R / 30 m)^2`` and ``(R / 10 m)^2`` are given beside their own.

    Args:
        transform: of one sample, without effects that change particles (they are not counted).

    Example:
        >>> from torchweather import Lidar, LidarSnow, Snow
        >>> found = open_air_returns(LidarSnow(Snow(1.0), Lidar.preset("velodyne-hdl-64e")))
        >>> found.slow < 0.1 * found.fast
        True
    """
    check_arguments("open_air_returns(transform: LidarWeather)", transform)
    sensor, own = transform.sensor, open_air_share(transform)
    if (sensor.near_start_m, sensor.near_full_m, sensor.near_power) != UNMEASURED:
        return OpenAirReturns(own)
    slow, fast = (
        open_air_share(
            LidarWeather(transform.weather, replace(sensor, near_start_m=0.0, near_full_m=full_m, near_power=2.0))
        )
        for full_m in (SLOW_M, FAST_M)
    )
    return OpenAirReturns(own, slow, fast)


def open_air_share(transform: LidarWeather) -> float:
    """Probability that a beam of the sensor's reach has a particle above the threshold."""
    stages = transform.chain.stages.values()
    returns = next((stage for stage in stages if isinstance(stage, ParticleReturns)), None)
    if returns is None:
        return 0.0
    extinction = next(stage for stage in stages if isinstance(stage, Extinction))
    with torch.no_grad():
        threshold = returns.beam.threshold.reshape(1, 1)
        alpha = extinction.extinction_per_m(1).to(threshold)
        reach = threshold.new_full((1, 1), transform.sensor.max_range_m)
        number = sum(
            float(part.expected_above(returns.beam, threshold, alpha, reach).max()) for part in returns.kinds.values()
        )
    return float(-torch.expm1(torch.tensor(-max(number, 0.0), dtype=torch.float64)))


def _percent(share: float) -> str:
    percent = 100 * share
    if 0 < percent < LEAST_PERCENT:
        return f"less than {LEAST_PERCENT:g} %"
    return "100 %" if percent >= 99.5 else f"{percent:.2g} %"
