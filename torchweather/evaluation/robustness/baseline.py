"""The result of another run as JSON, whose errors are the reference of the corruption error."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError
from torchweather.core.schema import check_format
from torchweather.core.yaml_file import read_json
from torchweather.evaluation.robustness.result import RobustnessResult

__all__ = ["RESULT_FORMAT", "read_baseline"]

RESULT_FORMAT = "torchweather-robustness/1"


def read_baseline(path: str | os.PathLike[str]) -> dict[str, Any]:
    """``robustness.json`` of another detector's run.

    Args:
        path: the file, or the folder that it is in.

    Raises:
        TorchweatherError: it is missing or something else.
    """
    file = Path(path)
    file = file / "robustness.json" if file.is_dir() else file
    values: Any = read_json(file, "the result of another run, robustness.json")
    check_format(values, RESULT_FORMAT, str(file), "the result of another run")
    return {**values, "path": str(file)}


def reference_of(baseline: dict[str, Any], result: RobustnessResult) -> dict[str, list[float]]:
    """The baseline's performance in the result's conditions, which must be the same, in the same measure."""
    where = baseline["path"]
    if baseline["measure"] != result.measure or baseline["thresholds"] != list(result.thresholds):
        raise TorchweatherError(
            f"{where}: the baseline has {baseline['measure']} at {baseline['thresholds']}; this run has "
            f"{result.measure} at {list(result.thresholds)}."
        )
    if baseline["frames"] != list(result.frames):
        raise TorchweatherError(
            f"{where}: the baseline must have seen the same frames; it saw {len(baseline['frames'])}, this run "
            f"{len(result.frames)}, not all of the same names."
        )
    there = {(each["weather"], each["severity"], each["value"]): each["performance"] for each in baseline["conditions"]}
    found: dict[str, list[float]] = {}
    for each in result.conditions:
        one = each.condition
        if (one.name, one.severity, one.value) not in there:
            raise TorchweatherError(
                f"{where}: the baseline lacks {one.name} of {one.value:g}, severity {one.severity}. Run it with the "
                "same --recipe."
            )
        found.setdefault(one.name, []).append(float(there[one.name, one.severity, one.value]))
    return found
