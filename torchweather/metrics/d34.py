"""The scores that ROADVIEW D3.4 published: its counts of expected trends re-counted, and where they contradict."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from itertools import combinations

from torchweather.metrics.trends import SceneTrends, expected_trends

__all__ = [
    "Inconsistency",
    "PublishedScore",
    "TrendCell",
    "inconsistencies",
    "published_direction",
    "published_scores",
    "trend_cells",
]

IMAGE_UP = ("PSNR", "SSIM", "MS-SSIM", "CW-SSIM", "IW-SSIM", "DSS", "VIF", "VSI", "FSIM", "SR-SIM", "HAAR-PSI")
IMAGE_DOWN = ("GMSD", "MS-GMSD", "MDSI")
CLOUD_DOWN = ("SDM", "RMSE", "MDE", "MMDE", "HD", "HD95")

# Abbreviations of the tables' scenes; the appendix writes the site after the data set's name.
SITES = {"THI": "-THI", "CE": "-CEREMA"}
# A PSNR of images in [0, 1] taken with a white of 255 is too high by this, dB.
WRONG_WHITE_DB = 20.0 * math.log10(255.0)


@dataclass(frozen=True)
class PublishedScore:
    """One score of the appendix."""

    appendix: str
    sensor: str
    source: str
    """Task the data come from: ``T3.2`` measured, ``T3.3`` and ``T3.4`` simulated."""
    weather: str
    dataset: str
    target: str
    distance_m: str
    condition: str
    severity: float
    """Rises with the weather: rate in mm/h, visibility in m with a minus sign, or a rank."""
    metric: str
    value: float

    @property
    def scene(self) -> tuple[str, str, str, str]:
        """Section, data set, target and distance: rows that differ in weather alone share it."""
        return self.appendix, self.dataset, self.target, self.distance_m

    @property
    def baseline(self) -> bool:
        """True where it was scored without weather; no level of severity."""
        return "Baseline" in self.condition


@dataclass(frozen=True)
class TrendCell:
    """One cell of Tables 12, 14 and 15."""

    table: int
    sensor: str
    weather: str
    scene: str
    source: str
    published: int | None
    """Metrics with the expected trend as printed; None where the cell has no number."""
    computed: int | None
    """The same from the scores of the appendix; None where it has none."""
    out_of: int
    levels: int
    """Conditions that the trend is judged on."""
    coin_flip: bool
    """True where these are two: each metric then shows the trend with probability 1/2 by chance."""
    metrics: tuple[str, ...]
    """Metrics with the expected trend."""


@dataclass(frozen=True)
class Inconsistency:
    """One contradiction inside the published scores."""

    name: str
    where: str
    why: str
    """Facts from the definitions."""
    found: int
    """Cases that contradict it."""
    of: int
    detail: str


@lru_cache(maxsize=1)
def published_scores() -> tuple[PublishedScore, ...]:
    """All scores of D3.4's appendix (10.1 to 10.3) as printed.

    Example:
        >>> rows = published_scores()
        >>> len(rows), rows[0].metric, rows[0].value
        (1638, 'PSNR', 34.39)
    """
    return tuple(
        PublishedScore(
            **{name: row[name] for name in ("appendix", "sensor", "source", "weather", "dataset", "target")},
            distance_m=row["distance_m"],
            condition=row["condition"],
            severity=float(row["condition_value"]) * (-1.0 if row["condition_unit"] == "m_visibility" else 1.0),
            metric=row["metric"],
            value=float(row["value"]),
        )
        for row in _table("d34_metric_scores.csv")
    )


def published_direction() -> dict[str, str]:
    """Of every metric as D3.4 spells it, ``up`` where higher is better, ``down`` where lower is better."""
    return dict.fromkeys(IMAGE_UP, "up") | dict.fromkeys((*IMAGE_DOWN, *CLOUD_DOWN), "down")


def trend_cells() -> list[TrendCell]:
    """Tables 12, 14 and 15 as printed, beside the count that the appendix gives.

    Note:
        Strictly monotone over all conditions of a scene, the baseline row of the PDD data left out; several frames
        of one sequence count by their mean.

    References:
        METRICS.md 3; D3.4 Tables 12, 14, 15 and appendix 10.

    Example:
        >>> numeric = [cell for cell in trend_cells() if cell.published is not None]
        >>> len(numeric), sum(cell.published == cell.computed for cell in numeric)
        (56, 56)
    """
    return [_cell(row) for row in _table("d34_expected_trends.csv")]


def inconsistencies() -> list[Inconsistency]:
    """Where the published scores contradict the definitions of their metrics or themselves, counted from the scores.

    References:
        METRICS.md 1 to 3.
    """
    return [*_cloud_order(), _repeated_scenes(), _white(), _swapped_vif(), *_rising_vif(), _two_levels(), _snow()]


def _table(name: str) -> list[dict[str, str]]:
    file = resources.files("torchweather").joinpath("data", "d34", name)
    return list(csv.DictReader(file.read_text(encoding="utf-8").splitlines()))


def _cell(row: dict[str, str]) -> TrendCell:
    scores = [score for score in published_scores() if _belongs(score, row)]
    trends = _trends(scores)
    return TrendCell(
        table=int(row["table"]),
        sensor=row["sensor"],
        weather=row["weather"],
        scene=row["scene"],
        source=row["source"],
        published=int(row["expected_trends"]) if row["expected_trends"] else None,
        computed=trends.expected if scores else None,
        out_of=int(row["out_of"]),
        levels=max((trend.levels for trend in trends.metrics.values()), default=0),
        coin_flip=trends.coin_flip,
        metrics=_shown(trends),
    )


def _belongs(score: PublishedScore, row: dict[str, str]) -> bool:
    """Check whether a score is of a cell; the tables name scenes as ``THI, Car, 28m`` or by the data set alone."""
    if (score.sensor, score.weather, score.source) != (row["sensor"], row["weather"], row["source"]):
        return False
    if row["scene"] == score.dataset:
        return True
    site, _, rest = row["scene"].partition(", ")
    target, _, distance = rest.partition(", ")
    return (
        site in SITES
        and score.dataset.endswith(SITES[site])
        and _kind(score.target) == _kind(target)
        and f"{score.distance_m}m" == distance
    )


def _kind(target: str) -> str:
    """Targets of the sensors go by many names (``Cam Target``, ``LiDAR Calibration Targets``, ``Sensor Target``)."""
    return "target" if "Target" in target else target


def _trends(scores: Iterable[PublishedScore]) -> SceneTrends:
    """Trends of the scores of one scene over the conditions they have."""
    rows = [score for score in scores if not score.baseline]
    severities = sorted({row.severity for row in rows})
    frames: dict[str, list[list[float]]] = {row.metric: [[] for _ in severities] for row in rows}
    for row in rows:
        frames[row.metric][severities.index(row.severity)].append(row.value)
    return expected_trends({"scene": frames}, published_direction(), resamples=1)["scene"]


def _shown(trends: SceneTrends) -> tuple[str, ...]:
    return tuple(metric for metric, trend in trends.metrics.items() if trend.verdict == "expected")


def _scenes(scores: Iterable[PublishedScore]) -> dict[tuple[str, str, str, str], list[PublishedScore]]:
    found: dict[tuple[str, str, str, str], list[PublishedScore]] = {}
    for score in scores:
        found.setdefault(score.scene, []).append(score)
    return found


def _clouds(wanted: Callable[[PublishedScore], bool] = lambda score: True) -> list[dict[str, float]]:
    """The six scores of every pair of clouds."""
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for score in published_scores():
        if score.metric in CLOUD_DOWN and wanted(score):
            found.setdefault((*score.scene, score.condition), {})[score.metric] = score.value
    return list(found.values())


def _cloud_order() -> Iterator[Inconsistency]:
    rows = _clouds()
    above = sum(row["MMDE"] < row["MDE"] for row in rows)
    equal = sum(row["MMDE"] == row["MDE"] for row in rows)
    yield Inconsistency(
        "mmde_not_above_mde",
        "10.2, 10.3",
        "MMDE is the larger of two means, MDE their weighted mean: MMDE >= MDE",
        above + equal,
        len(rows),
        f"{above} below it, {equal} equal to it to all printed digits",
    )
    measured = _clouds(lambda score: score.sensor == "radar4d" and score.source == "T3.2")
    below = [row["MDE"] - row["RMSE"] for row in measured if row["RMSE"] < row["MDE"]]
    yield Inconsistency(
        "rmse_below_mde",
        "10.3.1 to 10.3.3",
        "a root mean square is no less than the mean: RMSE >= MDE",
        len(below),
        len(measured),
        f"measured radar, up to {max(below):.2f} m below",
    )
    under = [row["MDE"] / row["HD"] for row in rows if row["HD"] < row["MDE"]]
    yield Inconsistency(
        "hd_below_mde",
        "10.2, 10.3",
        "a maximum is no less than the mean: HD >= MDE",
        len(under),
        len(rows),
        f"MDE up to {max(under):.1f} times HD",
    )


def _repeated_scenes() -> Inconsistency:
    scenes = {
        scene: {(row.condition, row.metric): row.value for row in rows}
        for scene, rows in _scenes(published_scores()).items()
    }
    pairs = [(one, other) for one, other in combinations(scenes, 2) if one[:3] == other[:3]]
    same = [(one, other) for one, other in pairs if scenes[one] == scenes[other]]
    return Inconsistency(
        "repeated_scene",
        ", ".join(one[0] for one, _ in same),
        "one target at two distances gives two tables",
        len(same),
        len(pairs),
        "; ".join(
            f"{one[0]}: all {len(scenes[one])} scores at {other[3]} m are those at {one[3]} m" for one, other in same
        ),
    )


def _white() -> Inconsistency:
    decibels: dict[str, list[float]] = {}
    for score in published_scores():
        if score.metric == "PSNR":
            decibels.setdefault(score.appendix, []).append(score.value)
    high = {section: values for section, values in decibels.items() if min(values) > WRONG_WHITE_DB}
    return Inconsistency(
        "psnr_white",
        ", ".join(high),
        f"a white of 255 for images in [0, 1] adds {WRONG_WHITE_DB:.2f} dB to the PSNR",
        len(high),
        len(decibels),
        "; ".join(
            f"{section}: {min(values):.2f} to {max(values):.2f} dB, {min(values) - WRONG_WHITE_DB:.2f} to "
            f"{max(values) - WRONG_WHITE_DB:.2f} without it"
            for section, values in high.items()
        ),
    )


def _swapped_vif() -> Inconsistency:
    vif = [score for score in published_scores() if score.metric == "VIF"]
    above = [score for score in vif if score.value > 1.0]
    return Inconsistency(
        "vif_above_one",
        ", ".join(sorted({score.appendix for score in above})),
        "weather takes information from an image: VIF <= 1, above it with swapped arguments",
        len(above),
        len(vif),
        f"up to {max(score.value for score in above):.4f}",
    )


def _rising_vif() -> Iterator[Inconsistency]:
    scenes = _scenes(score for score in published_scores() if score.metric == "VIF" and score.weather == "fog")
    rising = [scene for scene, rows in scenes.items() if _trends(rows).metrics["VIF"].verdict == "reversed"]
    yield Inconsistency(
        "vif_rises_with_fog",
        ", ".join(sorted({scene[0] for scene in rising})),
        "a veil lowers VIF; it rises with the fog when the arguments are swapped",
        len(rising),
        len(scenes),
        "scenes in which VIF rises at every step",
    )


def _two_levels() -> Inconsistency:
    numeric = [cell for cell in trend_cells() if cell.published is not None]
    two = [cell for cell in numeric if cell.coin_flip]
    return Inconsistency(
        "two_conditions",
        "Tables 12, 14, 15",
        "over two conditions each metric shows the expected trend with probability 1/2 by chance",
        len(two),
        len(numeric),
        f"these cells show {sum(cell.computed or 0 for cell in two)} of {sum(cell.out_of for cell in two)} trends",
    )


def _snow() -> Inconsistency:
    """Simulated snow on ACDC: one of three rates decides every trend (its size distribution: PHYSICS.md 2.4)."""
    section, left_out = "10.1.9", 2.70
    scenes = _scenes(score for score in published_scores() if score.appendix == section)
    whole = {scene: _trends(rows) for scene, rows in scenes.items()}
    rest = {scene: _trends(row for row in rows if row.severity != left_out) for scene, rows in scenes.items()}
    turned = sum(
        trend.verdict != "expected" and rest[scene].metrics[metric].verdict == "expected"
        for scene, trends in whole.items()
        for metric, trend in trends.metrics.items()
    )
    return Inconsistency(
        "one_snow_rate_decides",
        section,
        f"the row of {left_out:.2f} mm/h breaks the order of the two others",
        turned,
        sum(trends.out_of for trends in whole.values()),
        "; ".join(
            f"{scene[2]}: {whole[scene].expected} of {whole[scene].out_of}, without that row {rest[scene].expected} of "
            f"{rest[scene].out_of}"
            for scene in scenes
        ),
    )
