"""One case of a bench: its answer compared with its sealed truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from torchweather.stages.catalogue import EFFECTS

__all__ = ["NONE", "UNKNOWN", "Row", "metric_floors", "row_of"]

Row = dict[str, Any]
NONE, UNKNOWN = "none", "unknown"


def row_of(truth: Row, answer: Row, known: Row, floors: Mapping[str, float] | None = None) -> Row:
    """Compare an answer with the truth of its case.

    Args:
        truth: as sealed.
        answer: line of ``run``.
        known: line of ``known``; empty where there is none.
        floors: of metrics that no search uses (``metric_floors``); 1 of what is left out.
    """
    report = answer.get("report") or {}
    verdict = "refused" if answer.get("error") else report.get("verdict", "")
    effects = (report.get("effects") or []) if verdict in ("named", "named_and_rest") else []
    names = sorted(one["name"] for one in effects)
    true = sorted(one["name"] for one in truth["effects"] if one["name"] in EFFECTS)
    # Sets of the truth; what the answer itself says about confusion never makes a wrong name right.
    allowed = set(true)
    for one in truth["effects"]:
        allowed |= set(one["confusable_with"] or {})
    flags = [one["identifiable"] for one in truth["effects"]]
    gap = report.get("gap") or {}
    after, floor = gap.get("after"), gap.get("floor")
    right = truth.get("right")
    row: Row = {
        "case": truth["id"],
        "family": truth["family"],
        "weather": truth["weather"],
        "screen": bool(truth["options"].get("screen")),
        "decoy": truth["options"].get("decoy"),
        "true": true or sorted(one["name"] for one in truth["effects"]),
        "level": min((one["level"] for one in truth["effects"]), default=None),
        "identifiable": bool(flags) and all(flags),
        "same_form": all(one["same_form"] for one in truth["effects"]),
        "verdict": verdict,
        "names": names,
        "error": answer.get("error"),
        "exact": bool(true) and names == true,
        "in_confusion_set": bool(true) and bool(names) and set(names) <= allowed,
        "wrong": bool(set(names) - allowed),
        "confidence": [[one.get("confidence"), one["name"] in true] for one in effects],
        "gap_after_over_floor": after / floor if after is not None and floor else None,
        "gap_before": gap.get("before"),
        "p_value": report.get("p_value"),
        "seconds": answer.get("seconds"),
        "intervals": _intervals(truth, effects, (known.get("report") or {}).get("effects") or []),
        "other_metrics": _shrunk(answer.get("other_metrics"), floors or {}),
        "right_axis": _right_axis(truth, report),
        "right": None,
    }
    if right is not None:
        row["right"] = verdict in right["verdicts"] and set(names) <= set(right["names"])
    return row


def _number(value: Any) -> float:
    return float(value)  # "inf" and "-inf" are numbers too


def _intervals(truth: Row, effects: list[Row], known: list[Row]) -> list[Row]:
    """Each true finite parameter of a named effect with its interval, and its width over that of a fit that knows the
    effects."""
    found = []
    told = {one["name"]: one.get("interval") or {} for one in known}
    for one in truth["effects"]:
        for answer in effects:
            if answer["name"] != one["name"]:
                continue
            for name, value in one["parameters"].items():
                interval = (answer.get("interval") or {}).get(name)
                if interval is None or not np.isfinite(_number(value)):
                    continue
                low, high = (_number(end) for end in interval)
                row = {"parameter": f"{one['name']}.{name}", "true": _number(value), "low": low, "high": high}
                row["off"] = _off(one["name"], name, row["true"], (answer.get("parameters") or {}).get(name))
                found.append({**row, "over_known": _ratio(interval, told.get(one["name"], {}).get(name))})
    for one in found:
        one["covers"] = one["low"] <= one["true"] <= one["high"]
        if not np.isfinite(one["high"] - one["low"]):
            one["low"], one["high"] = str(one["low"]), str(one["high"])
    return found


def _off(effect: str, parameter: str, true: float, estimate: Any) -> float | None:
    """Error of a parameter over its departure from the identity; ``None`` where the identity is no number."""
    declared = next((one for one in EFFECTS[effect].arguments if one.name == parameter), None)
    if estimate is None or declared is None or declared.identity is None or not np.isfinite(declared.identity):
        return None
    size = abs(true - declared.identity)
    return abs(_number(estimate) - true) / size if size > 0.0 else None


def _ratio(interval: list[Any], other: list[Any] | None) -> float | None:
    """Width of an interval over that of another one; ``None`` where there is none, or one that is no length."""
    if other is None:
        return None
    width, known = (_number(one[1]) - _number(one[0]) for one in (interval, other))
    return width / known if np.isfinite(width) and np.isfinite(known) and known > 0.0 else None


# Gaps before, over the floor, from which shrinking means something; null studies that tell a floor.
STANDS_OUT, LEAST_NULLS = 2.0, 4


def metric_floors(truths: Mapping[str, Row], answers: Mapping[str, Row]) -> dict[str, dict[str, float]]:
    """Weather to metric to the gap that the model leaves where nothing is hidden: root mean square, 1 at least.

    Two codes of one weather do not agree to the noise of such a metric: where an echo of fog lies on its flank moves
    the mean range of all returns. No effect that is added can take that off.
    """
    found: dict[str, list[Row]] = {}
    for case, one in answers.items():
        truth = truths.get(case)
        if truth and truth["family"] == "null" and not truth["options"].get("screen") and one.get("other_metrics"):
            found.setdefault(truth["weather"], []).append(one["other_metrics"]["before"])
    return {
        weather: {name: max(float(np.sqrt(np.mean([gaps[name] ** 2 for gaps in each]))), 1.0) for name in each[0]}
        for weather, each in found.items()
        if len(each) >= LEAST_NULLS
    }


def _shrunk(gaps: Row | None, floors: Mapping[str, float]) -> dict[str, float] | None:
    """Excess over the floor that is left, over the excess before, of each metric that stood out."""
    if gaps is None:
        return None
    found = {}
    for name, before in gaps["before"].items():
        floor = floors.get(name, 1.0)
        if before >= STANDS_OUT * floor:
            found[name] = max(gaps["after"][name] - floor, 0.0) / (before - floor)
    return found


# Words by which an answer's axis is recognised; any other by its own.
AXES = {
    "range": ("range", "depth", "distance"),
    "azimuth": ("azimuth", "column", "sector"),
    "elevation": ("elevation", "ring", "row"),
    "intensity": ("intensity", "reflectivity", "margin", "energy"),
    "incidence": ("incidence", "up", "normal", "slope"),
    "frame": ("frame", "time", "between"),
    "any": ("",),
}


def _right_axis(truth: Row, report: Row) -> bool:
    axes = {axis for one in truth["effects"] for axis in one.get("axes") or ()}
    said = []
    unknown = report.get("unknown")
    if isinstance(unknown, Mapping):
        said.append(str(unknown.get("axis", "")))
    said += [str(one.get("axis", "")) for one in (report.get("where") or [])[:1]]
    first = said[:1]
    return any(word in text for axis in axes for word in AXES.get(axis, (axis,)) for text in first)
