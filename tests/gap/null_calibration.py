"""Studies in which nothing is hidden: squares of each statistic over those of noise, and how likely departures are.

``python -m tests.gap.null_calibration --kind lidar-snow --number 60`` prints the table of one kind.

Each study is one of the model itself. What a study leaves of a statistic, systematics fitted, is divided by what noise
drawn from the stated scatter leaves of it, fitted alike: 1 where the scatter is right. The probabilities of the largest
gain of any effect and of the whole misfit are uniform then.

References:
    GAP.md 3 (2, 7). Kolmogorov 1933 (uniform probabilities).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kstest

from tests.gap.tiny_camera_study import values_of
from tests.gap.tiny_radar_study import tiny_radar_study
from tests.gap.tiny_study import tiny_study
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap import Study
from torchweather.gap.find import MODELS
from torchweather.gap.inference.config import METHOD, NUMERICS
from torchweather.gap.inference.degrees_of_freedom import as_of_known_noise
from torchweather.gap.inference.effect_forms import effect_class
from torchweather.gap.inference.global_test import run_global_test
from torchweather.gap.inference.likelihood import SimulatorLikelihood
from torchweather.gap.inference.simulated_distribution import observations
from torchweather.gap.study.hidden import WEATHERS, hidden_study

__all__ = ["STUDIES", "NullStudy", "null_study", "ratios"]

Made = Callable[[int], Study]

STUDIES: dict[str, Made] = {
    "radar": lambda seed: tiny_radar_study(seed=seed),
    "camera-rain": lambda seed: Study.from_arrays(**values_of(kind="rain", seed=seed)),
    "camera-snow": lambda seed: Study.from_arrays(**values_of(kind="snow", seed=seed)),
    "camera-fog": lambda seed: Study.from_arrays(**values_of(kind="fog", seed=seed)),
    "lidar-rain": lambda seed: hidden_study((), WEATHERS["rain"], seed=seed).study,
    "lidar-snow": lambda seed: tiny_study((), seed=seed),
    "lidar-snow-few": lambda seed: tiny_study((), seed=seed, clear=3, frames=3),
}


@dataclass(frozen=True)
class NullStudy:
    """One study in which nothing is hidden, against the search.

    Args:
        squares, by_noise: statistic to the sum of squares that the study and noise leave.
        gain_p, misfit_p: probabilities of the largest gain of any effect, and of the misfit.
        alarm_p: of the alarm.
    """

    squares: dict[str, float]
    by_noise: dict[str, float]
    gain_p: float
    misfit_p: float
    alarm_p: float


def null_study(study: Study, templates: bool = True) -> NullStudy:
    """Hold a study against the search.

    Args:
        study: in which nothing is hidden.
        templates: whether effects are tried; without, the alarm's and the gain's probabilities are ``nan``.
    """
    model = MODELS[study.kind](study, None, ())
    with one_thread_an_operation():
        search = SimulatorLikelihood(model, observations(model, model.fit), 0)
        fit = search.begin()
        effects = [effect_class(model, name) for name in model.catalogue]
        alarm = run_global_test(search, effects, fit, 0) if templates else None
    noise = fit.nuisance(search.null_residuals(fit.nuisance, NUMERICS.null_draws, 0))
    left, groups = fit.nuisance.left(fit.residual), model.layout.groups
    statistic = np.tile(
        np.repeat([group.statistic for group in groups], [group.bins for group in groups]), len(search.measured)
    )
    drawn = (noise**2).mean(0)

    def by_statistic(values: NDArray[np.float64]) -> dict[str, float]:
        return {str(name): float(values[statistic == name].sum()) for name in dict.fromkeys(statistic)}

    misfit_p = float(((noise**2).sum(1) >= (left**2).sum()).mean())
    gain_p = float("nan")
    if alarm is not None:
        gain_p = float((alarm.best_null >= as_of_known_noise(alarm.gains, alarm.degrees_of_freedom).max()).mean())
    return NullStudy(
        by_statistic(left**2), by_statistic(drawn), gain_p, misfit_p, float("nan") if alarm is None else alarm.p_value
    )


def ratios(found: Sequence[NullStudy]) -> dict[str, tuple[float, float]]:
    """Statistic to its squares over those of noise, over all studies, and the error of that.

    The error is that of the mean over studies, each weighed by the squares of its noise.
    """
    table = {}
    for name in dict.fromkeys(one for each in found for one in each.squares):
        squares, by_noise = (
            np.array([getattr(each, field).get(name, 0.0) for each in found]) for field in ("squares", "by_noise")
        )
        if by_noise.sum() < 1.0:
            continue
        ratio = squares.sum() / by_noise.sum()
        error = math.sqrt(float(((squares - ratio * by_noise) ** 2).sum())) / by_noise.sum()
        table[name] = float(ratio), float(error)
    return table


def main() -> None:
    """Print the table of one kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kind", choices=STUDIES, required=True)
    parser.add_argument("--number", type=int, default=60, help="of studies")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    asked = parser.parse_args()
    found = []
    for seed in range(asked.first, asked.first + asked.number):
        found.append(null_study(STUDIES[asked.kind](seed)))
        one = found[-1]
        print(
            f"seed {seed}: gain p {one.gain_p:.3f}, misfit p {one.misfit_p:.3f}, alarm p {one.alarm_p:.1e}", flush=True
        )
    for name, (ratio, error) in ratios(found).items():
        print(f"{name:40} {ratio:5.2f} +- {error:.2f}")
    whole = sum(sum(one.squares.values()) for one in found) / sum(sum(one.by_noise.values()) for one in found)
    print(f"{'all':40} {whole:5.2f}")
    for field in ("gain_p", "misfit_p"):
        values = [getattr(one, field) for one in found]
        quartiles = np.quantile(values, [0.25, 0.5, 0.75])
        print(f"{field}: Kolmogorov {kstest(values, 'uniform').pvalue:.3f}, quartiles {quartiles}")
    print(f"alarms: {sum(one.alarm_p < METHOD.alarm_p for one in found)} of {len(found)}")


if __name__ == "__main__":
    main()
