"""Reports of the search for a missing effect, made up: one for each verdict."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from torchweather.gap.gap_report import BinDeparture, Curve, GapReport, ResidualMap, Response
from torchweather.gap.natural_units import NaturalDeparture
from torchweather.gap.places import CellValues, Places
from torchweather.gap.study.study import Study
from torchweather.lidar.effects.all import EFFECTS
from torchweather.lidar.effects.empirical import Empirical

RANGE_M = (0.0, 8.0, 17.0, 30.0, 55.0, 110.0, 1000.0)
SECTORS = tuple(float(v) for v in np.linspace(-math.pi, math.pi, 17))
WINDOW_LOSS = {
    "name": "lidar.window_loss",
    "parameters": {"loss_db": 0.02},
    "interval": {"loss_db": [0.018, 0.022]},
    "confidence": 0.973,
    "confusable_with": [],
}
STATIC = {
    "name": "lidar.static_structure",
    "parameters": {"azimuth_rad": -0.52, "range_m": 9.7, "width_rad": 0.031},
    "interval": {"azimuth_rad": [-0.54, -0.5], "range_m": [9.6, 9.8], "width_rad": [0.025, 0.037]},
    "confidence": 0.9991,
    "confusable_with": ["lidar.sector_loss"],
}
CANDIDATES = [
    {"name": "lidar.window_loss", "gain": 812.0, "misfit": 431.0, "weight": 0.973, "parameters": {"loss_db": 0.02}},
    {"name": "lidar.threshold_shift", "gain": 420.0, "misfit": 823.0, "weight": 0.02, "parameters": {"shift_db": 0.4}},
    {
        "name": "lidar.intensity_compression",
        "gain": 377.0,
        "misfit": 866.0,
        "weight": 0.007,
        "parameters": {"exponent": 0.97, "saturation": "inf"},
    },
]
WHERE = [
    {
        "statistic": "log_intensity_ratio",
        "axis": "range_m",
        "from": 17.0,
        "to": 30.0,
        "z": -18.3,
        "departure": -0.52,
        "unit": "dB",
    },
    {
        "statistic": "lost_share",
        "axis": "azimuth_rad",
        "from": -math.pi,
        "to": math.pi / 2,
        "z": 6.7,
        "departure": 3.1,
        "unit": "% of beams",
    },
]
RIPPLE = [round(0.05 * math.sin(3.0 * 0.5 * (a + b) + 0.4), 4) for a, b in itertools.pairwise(SECTORS)]
EMPIRICAL = Empirical(
    "intensity",
    "azimuth_rad",
    [0.5 * (a + b) for a, b in itertools.pairwise(SECTORS)][1:],
    RIPPLE[1:],
    SECTORS[1],
    SECTORS[-1],
)
# A ripple of the intensity over the azimuth; its first sector holds too little.
UNKNOWN: dict[str, Any] = {
    "statistic": "log_intensity_ratio",
    "axis": "azimuth_rad",
    "from": SECTORS[3],
    "to": SECTORS[4],
    "z": 7.4,
    "curve": {
        "edges": list(SECTORS),
        "value": [None, *RIPPLE[1:]],
        "low": [None, *(value - 0.011 for value in RIPPLE[1:])],
        "high": [None, *(value + 0.011 for value in RIPPLE[1:])],
        "unit": "ln(intensity ratio)",
    },
    "formula": {
        "name": "sine",
        "text": "0.0513 sin(3 azimuth_rad + 0.4)",
        "parameters": {"amplitude": 0.0513, "phase_rad": 0.4, "times": 3.0},
        "chi2_per_dof": 1.13,
        "values": RIPPLE,
    },
    "empirical": EMPIRICAL.config(),
    "why_not": None,
}
# The power of the laser drifts: one number, which no stage can copy.
DRIFT: dict[str, Any] = {
    "statistic": "log_intensity_ratio",
    "axis": "time",
    "from": 0.0,
    "to": 1.0,
    "z": -12.0,
    "curve": {
        "edges": [0.0, 1.0],
        "value": [-0.21],
        "low": [-0.24],
        "high": [-0.18],
        "unit": "change from the first frame to the last",
    },
    "formula": None,
    "empirical": None,
    "why_not": "it changes from the first frame to the last, and a stage does not know when a frame was taken",
}


def curves(study: Study, *, size: float, left: float | None) -> tuple[Curve, ...]:
    """Departures of about ``size`` before and ``left`` after (``None``: nothing was added); the last bin is empty."""
    rng = np.random.default_rng(4)
    found = []
    for statistic, axis, edges in (
        ("log_intensity_ratio", "range_m", RANGE_M),
        ("lost_share", "azimuth_rad", SECTORS),
        ("particles_before_objects", "particle_range_m", RANGE_M),
    ):
        for one in (each for each in study.fit if each.weather is not None):
            bins = len(edges) - 1
            before = -size * np.linspace(0.4, 1.0, bins) + rng.standard_normal(bins)
            before[-1] = np.nan
            after = None if left is None else left * rng.standard_normal(bins)
            unit = {"log_intensity_ratio": "dB", "lost_share": "% of beams"}.get(statistic, "returns per frame")
            natural = NaturalDeparture(unit, 0.1 * before, None if after is None else 0.1 * after, np.full(bins, 0.1))
            found.append(Curve(statistic, axis, edges, one.id, before, after, natural))
    return tuple(found)


def responses(study: Study) -> tuple[Response, ...]:
    """The measurement and three effects, of which the first fits."""
    rng = np.random.default_rng(5)
    shape = -20.0 * np.linspace(0.4, 1.0, len(RANGE_M) - 1)
    shape[-1] = np.nan
    given = [(None, shape + rng.standard_normal(len(shape)))]
    given += [(one["name"], shape * share) for one, share in zip(CANDIDATES, (1.0, 0.5, -0.2), strict=True)]
    return tuple(
        Response("log_intensity_ratio", "range_m", RANGE_M, name, values, 0.03 * values, "dB") for name, values in given
    )


def places(study: Study, *, fitted: bool) -> Places:
    """A scan of 4 x 6 cells, of which the first row departs by 1 dB and one cell holds nothing."""
    before = np.where(np.arange(24) < 6, 1.0, 0.02)
    before[-1] = np.nan
    values = CellValues(
        "intensity over clear air's",
        "dB",
        before[None],
        np.zeros((1, 24)),
        None,
        np.zeros(24),
        shape=(4, 6),
        x_name="azimuth, degrees",
        y_name="ring, from the first",
        extent=(180.0, -180.0, 16.0, 0.0),
        frame=np.full((16, 24), 0.5),
    )
    (first, *_) = [one.id for one in study.fit if one.weather is not None]
    return Places(first, 5, values, before, 0.01 * before if fitted else None, np.full(24, 0.1))


def residuals(study: Study, *, fitted: bool) -> ResidualMap:
    """Three statistics, of which the last has too little in it."""
    groups = (("log_intensity_ratio", "range_m"), ("lost_share", "azimuth_rad"), ("particles", "place"))
    conditions = tuple(one.id for one in study.fit if one.weather is not None)
    before = np.tile([[14.0], [6.5], [np.nan]], (1, len(conditions)))
    largest = (BinDeparture(-2.4, "dB", 17.0, 23.0), BinDeparture(3.1, "% of beams", 0.0, 0.4), None)
    return ResidualMap(groups, conditions, before, np.ones_like(before) if fitted else None, largest)


def report(verdict: str, study: Study, **more: Any) -> GapReport:
    """A report of a study with a verdict; ``more`` replaces parts of the answer."""
    found: dict[str, list[dict[str, Any]]] = {"named": [WINDOW_LOSS], "named_and_rest": [STATIC, WINDOW_LOSS]}
    nothing = verdict == "none"
    gap = {"floor": 1.0, "split": "holdout", "before": 1.03 if nothing else 2.13, "after": 1.03}
    nuisance = {one.id: 1.02 + 0.1 * number for number, one in enumerate(study.fit) if one.weather is not None}
    answer: dict[str, Any] = {
        "format": "torchweather-gap/1",
        "verdict": verdict,
        "effects": found.get(verdict, []),
        "catalogue": [name for name in EFFECTS if name.startswith("lidar.")],
        "conditions": {split: [one.id for one in getattr(study, split) if one.weather] for split in ("fit", "holdout")},
        "where": [] if nothing else WHERE,
        "nuisance": {"rate_factor": 1.04, "by_condition": nuisance},
        "gap": {**gap, "interval_after": [0.94, 1.13]},
        "p_value": 0.314 if nothing else 3e-12,
        "clear_air": [
            {"scene": name, "p_value": 0.27, "statistic": "lost_share", "axis": "range_m", "z": 2.1}
            for name in study.scenes
        ],
        "unknown": {"named_and_rest": DRIFT, "unknown": UNKNOWN}.get(verdict),
        "candidates": [] if nothing else CANDIDATES,
        "simulated_frames": 4321,
        "seconds": 41.2,
        "seed": 7,
        **more,
    }
    stages = tuple(
        EFFECTS[one["name"]](**{name: float(value) for name, value in one["parameters"].items()})
        for one in answer["effects"]
    )
    picture = curves(study, size=1.0 if nothing else 14.0, left=None if nothing else 1.0)
    return GapReport(
        answer,
        stages,
        picture,
        study.sha256,
        EMPIRICAL if verdict == "unknown" else None,
        () if nothing else responses(study),
        residuals(study, fitted=not nothing),
        places(study, fitted=not nothing),
    )
