"""Mean corruption error and resilience rate of a detector."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from torchweather.core.arguments import check_arguments
from torchweather.core.errors import InputValueError, check_between

__all__ = ["Rates", "rates"]


@dataclass(frozen=True)
class Rates:
    """Resilience and corruption error of a performance; NaN where a divisor is 0.

    Args:
        resilience: by weather, ``RR_c = sum_s P_{s,c} / (S P_clear)``.
        mean_resilience: mRR, mean over the weathers.
        corruption_error: by weather, ``CE_c = sum_s E_{s,c} / sum_s E^ref_{s,c}``.
        mean_corruption_error: mCE, mean over the weathers.
        reference: whose errors stand below: ``clear`` (``E^ref_{s,c} = E_clear`` of the same detector) or ``baseline``.
    """

    resilience: Mapping[str, float]
    mean_resilience: float
    corruption_error: Mapping[str, float]
    mean_corruption_error: float
    reference: str


def rates(
    clear: float,
    weathers: Mapping[str, Sequence[float]],
    baseline: Mapping[str, Sequence[float]] | None = None,
) -> Rates:
    """Resilience rate and corruption error over weathers and severities.

    With a performance P in [0, 1] (AP, mIoU) the error is ``E = 1 - P``.

    Args:
        clear: performance in clear air.
        weathers: performance in every severity s = 1..S of every weather c.
        baseline: the same of another detector, whose errors are the reference; without it the detector's own error in
            clear air is.

    Returns:
        The rates. A resilience of 1 is a detector that the weather does not touch; a corruption error of 1 is one as
        bad as the reference, below 1 a better one.

    References:
        Hendrycks and Dietterich 2019 (arXiv:1903.12261), section 4: mCE, there with AlexNet as the baseline. Kong et
        al. 2023, "Robo3D" (arXiv:2303.17597), section 3.3: mCE and mRR of LiDAR detectors, performance as mIoU or AP.

    Example:
        >>> found = rates(0.8, {"rain": [0.8, 0.4], "fog": [0.4, 0.0]})
        >>> round(found.mean_resilience, 3), {name: round(value, 2) for name, value in found.corruption_error.items()}
        (0.5, {'rain': 2.0, 'fog': 4.0})
        >>> better = rates(0.8, {"rain": [0.8, 0.4]}, baseline={"rain": [0.6, 0.0]})
        >>> round(better.mean_corruption_error, 3)
        0.571
    """
    check_arguments("rates(clear: float, weathers: Mapping, baseline: Mapping | None)", clear, weathers, baseline)
    for name, values in {"clear": [clear], **weathers, **(baseline or {})}.items():
        check_arguments("rates(weathers: Sequence)", values)
        for value in values:
            check_arguments("rates(weathers: float)", value)
            if not math.isnan(value):
                check_between(f"performance ({name})", value, 0.0, 1.0, owner="rates")
    if not weathers or not all(len(values) for values in weathers.values()):
        raise InputValueError("rates: expected one weather or more, with a performance each; got none.")
    if baseline is not None and {k: len(v) for k, v in baseline.items()} != {k: len(v) for k, v in weathers.items()}:
        raise InputValueError(
            f"rates: the baseline must have the same weathers and severities, {', '.join(weathers)}; got "
            f"{', '.join(baseline)}."
        )
    resilience = {name: _ratio(float(np.sum(v)), len(v) * clear) for name, v in weathers.items()}
    errors = {}
    for name, values in weathers.items():
        reference = [clear] * len(values) if baseline is None else baseline[name]
        errors[name] = _ratio(float(np.sum(1 - np.asarray(values))), float(np.sum(1 - np.asarray(reference))))
    return Rates(
        resilience,
        float(np.mean([*resilience.values()])),
        errors,
        float(np.mean([*errors.values()])),
        "clear" if baseline is None else "baseline",
    )


def _ratio(above: float, below: float) -> float:
    return above / below if below > 0 else math.nan
