"""A small record of microwave links in showers, with losses hidden at the ends and on the path.

The generator has its own rain, its own film and its own noise; of the library it takes the law of attenuation alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from torchweather.gap import Study
from torchweather.gap.sensors.link.study_kind import rain_attenuation_db

LINKS, STEPS = 80, 600
STEP_MIN = 5.0


def link_record(
    seed: int = 0, *, constant_db: float = 0.0, film_db: float = 0.0, drying_min: float = 12.0, scale: float = 1.0
) -> dict[str, Any]:
    """Links of 0.4 to 12 km in showers, with 0.15 dB of noise and a reference that is off by 30 % in an hour."""
    rng = np.random.default_rng(seed)
    links = {
        "length_km": np.exp(rng.uniform(math.log(0.4), math.log(12.0), LINKS)),
        "frequency_ghz": rng.uniform(18.0, 38.0, LINKS),
        "polarisation": rng.integers(0, 2, LINKS),
        "split": np.arange(LINKS) % 2,
    }
    rain = np.zeros((STEPS, LINKS, 1))
    for start in range(20, STEPS - 40, 60):
        length = int(rng.integers(6, 20))
        peak = math.exp(rng.uniform(math.log(0.5), math.log(20.0)))
        rain[start : start + length, :, 0] = peak * rng.uniform(0.2, 1.0, (length, 1)) * rng.uniform(0.3, 1.5, LINKS)
    hours = np.repeat(rng.normal(0.0, 0.3, (STEPS // 12, LINKS)), 12, 0)
    loss = scale * rain_attenuation_db(links, rain * np.exp(hours)[..., None])
    wet, film = np.zeros(LINKS), np.zeros(LINKS)
    for step in range(STEPS):
        raining = rain[step, :, 0] >= 0.1
        decay = math.exp(-STEP_MIN / drying_min)
        wet = np.where(raining, 1.0, wet * decay)
        film = np.where(raining, np.sqrt(rain[step, :, 0]), film * decay)
        loss[step] += constant_db * wet + film_db * film
    series = {
        "time_s": 60.0 * STEP_MIN * np.arange(STEPS),
        "attenuation_db": loss + rng.normal(0.0, 0.15, loss.shape),
        "rain_mm_per_h": rain,
    }
    return {"links": links, "series": series}


def tiny_link_study(rel_sd: float = 0.0, **more: Any) -> Study:
    """A study of one condition; ``more`` as of `link_record`."""
    made = link_record(**more)
    condition = {"id": "may", "frames": [made["series"]], "rel_sd": rel_sd}
    return Study.from_arrays(kind="link", links=made["links"], conditions=[condition])
