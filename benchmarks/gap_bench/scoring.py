"""Answers against the sealed truth: shares with Wilson intervals, confusion, calibration, coverage."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from .case_row import NONE, UNKNOWN, Row, metric_floors, row_of

__all__ = ["score", "wilson"]


def wilson(hits: int, of: int, z: float = 1.96) -> list[float] | None:
    """95 % interval of a share (Wilson 1927)."""
    if of == 0:
        return None
    share, spread = hits / of, z**2 / of
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = z / (1.0 + spread) * np.sqrt(share * (1.0 - share) / of + 0.25 * spread / of)
    return [round(float(max(middle - half, 0.0)), 4), round(float(min(middle + half, 1.0)), 4)]


def share(rows: Iterable[Row], holds: Callable[[Row], bool]) -> Row:
    """How many rows hold, of how many, with the interval."""
    listed = list(rows)
    hits = sum(bool(holds(row)) for row in listed)
    return {
        "hits": hits,
        "of": len(listed),
        "share": hits / len(listed) if listed else None,
        "wilson_95": wilson(hits, len(listed)),
    }


def score(
    truths: Mapping[str, Row],
    answers: Iterable[Row],
    known: Iterable[Row] = (),
    floors: float = 1.15,
    alone: Iterable[Row] = (),
) -> Row:
    """The table of a bench.

    Args:
        truths: by case.
        answers: lines of ``run``: ``case``, and ``report`` (of ``gap.json``) or ``error``. Of several of a case the
            first counts.
        known: lines of ``known``: the same for a search that may name the true effects alone.
        floors: held-out gap after over its floor, up to which it counts as near.
        alone: lines of ``time``: seconds of some studies, searched by one process alone; none: those of the answers.
    """
    told, timed, answered = _first(known), _first(alone), _first(answers)
    left = metric_floors(truths, answered)
    rows = [
        row_of(truths[case], one, told.get(case, {}), left.get(truths[case]["weather"]))
        for case, one in answered.items()
        if case in truths
    ]
    singles = [row for row in rows if row["family"] == "single"]
    clear_cut = [row for row in singles if row["identifiable"] and row["level"] >= 10.0]
    several = [row for row in rows if row["family"] in ("pair", "triple")]
    nulls = [row for row in rows if row["family"] == "null"]
    outside = [row for row in rows if row["family"] == "outside"]
    decoys = [row for row in rows if row["family"] == "decoy"]
    named = [row for row in singles + several if row["exact"] and row["gap_after_over_floor"] is not None]
    seconds = [row["seconds"] for row in rows if row["seconds"] is not None and not row["screen"]]
    by_itself = [timed[row["case"]]["seconds"] for row in rows if row["case"] in timed]
    seconds = by_itself or seconds
    table: Row = {
        "answered": sum(not row["screen"] for row in rows),
        "made": sum(not truth["options"].get("screen") for truth in truths.values()),
        "errors": sorted(row["case"] for row in rows if row["error"]),
        "singles_exact": share(singles, _is("exact")),
        "singles_identifiable_exact": share(clear_cut, _is("exact")),
        "singles_in_confusion_set": share(singles, _is("in_confusion_set")),
        "singles_wrong_asserted": share(singles, _is("wrong")),
        "singles_identifiable_unknown": share(clear_cut, lambda row: row["verdict"] == UNKNOWN),
        "by_level": {
            f"{level:g}": share((row for row in singles if row["level"] == level), _is("exact"))
            for level in sorted({row["level"] for row in singles})
        },
        "by_weather": {
            weather: share((row for row in singles if row["weather"] == weather), _is("exact"))
            for weather in sorted({row["weather"] for row in singles})
        },
        "pairs_both": share((row for row in several if row["family"] == "pair"), _is("exact")),
        "triples_all": share((row for row in several if row["family"] == "triple"), _is("exact")),
        "several_wrong_asserted": share(several, _is("wrong")),
        "nulls_alarm": share((row for row in nulls if not row["screen"]), lambda row: row["verdict"] != NONE),
        "screen_nulls_alarm": share((row for row in nulls if row["screen"]), lambda row: row["verdict"] != NONE),
        "outside_unknown": share(outside, lambda row: row["verdict"] == UNKNOWN),
        "outside_detected": share(outside, lambda row: row["verdict"] != NONE),
        "outside_right_axis": share((row for row in outside if row["verdict"] != NONE), _is("right_axis")),
        "decoys_right": share(decoys, _is("right")),
        "decoys": {row["case"]: [row["decoy"], row["verdict"], row["names"], row["right"]] for row in decoys},
        "coverage_90": _coverage(row for row in rows if row["exact"]),
        "coverage_90_same_form": _coverage(row for row in rows if row["exact"] and row["same_form"]),
        "parameter_off_over_departure": _offs(row for row in rows if row["exact"] and row["same_form"]),
        "interval_width_over_known": _widths(row for row in rows if row["exact"]),
        "other_metrics_after_over_before": _other(row for row in rows if row["exact"]),
        **({"other_metrics_floors": left} if left else {}),
        "gap_after_near_floor": {
            **share(named, lambda row: row["gap_after_over_floor"] <= floors),
            "floors": floors,
        },
        "seconds": {"median": _median(seconds), "most": max(seconds, default=None), "alone": len(by_itself)},
        "calibration": _calibration(rows),
        "confusion": _confusion(rows),
    }
    return {"table": table, "cases": rows}


def _first(lines: Iterable[Row]) -> dict[str, Row]:
    found: dict[str, Row] = {}
    for one in lines:
        found.setdefault(one["case"], one)
    return found


def _is(name: str) -> Callable[[Row], bool]:
    return lambda row: bool(row[name])


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def _offs(rows: Iterable[Row]) -> Row:
    """Errors of the parameters of exact answers, of effects of the catalogue's own form."""
    values = [one["off"] for row in rows for one in row["intervals"] if one["off"] is not None]
    return {"median": _median(values), "most": max(values, default=None), "of": len(values)}


def _widths(rows: Iterable[Row]) -> Row:
    """Of all parameters of exact answers that a fit with the true effects alone gives an interval as well."""
    ratios = [one["over_known"] for row in rows for one in row["intervals"] if one["over_known"] is not None]
    return {"median": _median(ratios), "of": len(ratios)}


def _other(rows: Iterable[Row]) -> Row:
    """Median over cases of the median over the metrics that stood out, and the median of each metric."""
    listed = [row["other_metrics"] for row in rows if row["other_metrics"] is not None]
    each = [float(np.median(list(one.values()))) for one in listed if one]
    metrics = sorted({name for one in listed for name in one})
    return {
        "median": _median(each),
        "of": len(each),
        "nothing_stood_out": sum(not one for one in listed),
        "by_metric": {name: _median([one[name] for one in listed if name in one]) for name in metrics},
    }


def _coverage(rows: Iterable[Row]) -> Row:
    return share((one for row in rows for one in row["intervals"]), _is("covers"))


def _calibration(rows: list[Row], bins: int = 5) -> list[Row]:
    """Share of right names among those asserted with a confidence, by confidence."""
    pairs = [pair for row in rows if row["family"] != "decoy" for pair in row["confidence"] if pair[0] is not None]
    found = []
    for low in np.linspace(0.0, 1.0, bins, endpoint=False):
        inside = [
            right
            for value, right in pairs
            if low <= value < low + 1.0 / bins or (value == 1.0 and low + 1.0 / bins >= 1.0)
        ]
        mean = [
            value for value, _ in pairs if low <= value < low + 1.0 / bins or (value == 1.0 and low + 1.0 / bins >= 1.0)
        ]
        hits = sum(inside)
        found.append(
            {
                "from": round(float(low), 3),
                "mean_confidence": float(np.mean(mean)) if mean else None,
                "right": hits,
                "of": len(inside),
                "wilson_95": wilson(hits, len(inside)),
            }
        )
    return found


def _confusion(rows: list[Row]) -> dict[str, dict[str, int]]:
    """What was answered where one effect, or none, was hidden."""
    found: dict[str, dict[str, int]] = {}
    for row in rows:
        if row["family"] not in ("single", "null", "outside") or row["screen"]:
            continue
        truth = (row["true"] or [NONE])[0]
        said = " + ".join(row["names"]) or row["verdict"]
        found.setdefault(truth, {})[said] = found.get(truth, {}).get(said, 0) + 1
    return found
