"""Why a score does not follow the weather: whether chance explains a step."""

from __future__ import annotations

import numpy as np
import pytest

from torchweather.evaluation.sweep.misses import _kind_of_step


@pytest.mark.parametrize(("step", "kind"), [(0.5, "within"), (1.0, "beyond"), (-1.0, "beyond")])
def test_a_step_is_compared_with_the_error_of_its_mean(step: float, kind: str) -> None:
    """25 seeds that scatter by 2: the mean has an error of 0.4, and Student's t at 24 degrees ends at 1.71: 0.68."""
    scatter = np.where(np.arange(25) % 2, 1.0, -1.0)
    scatter = (scatter - scatter.mean()) * (2.0 / scatter.std(ddof=1))
    assert _kind_of_step(np.stack([np.zeros(25), step + scatter]), 0) == kind
