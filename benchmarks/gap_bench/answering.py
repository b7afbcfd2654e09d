"""Answers of the gap workflow."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchweather.core.errors import TorchweatherError
from torchweather.core.threads import one_thread_an_operation
from torchweather.gap.study.study import Study

from .generator.bench_sensor import OtherMetrics

__all__ = ["answer"]


def answer(
    folder: Path, seed: int, effects: Sequence[str] | None = None, other_metrics: OtherMetrics | None = None
) -> dict[str, Any]:
    """Answer of the workflow to a study.

    Args:
        folder: of the study.
        seed: of the workflow.
        effects: that may be named; ``None``: all.
        other_metrics: of the sensor.

    Returns:
        ``seconds``, and ``report`` (as ``gap.json``), or ``error`` where the workflow refuses the study; also
        ``other_metrics``, if the sensor has some; their time does not count. Any other exception is a fault of the
        workflow: it breaks the run off and is no answer.
    """
    from torchweather.gap import find_gap

    start = time.perf_counter()
    try:
        study = Study.read(folder)
        report = find_gap(study, effects=effects, seed=seed)
    except TorchweatherError as error:
        return {"seconds": round(time.perf_counter() - start, 2), "error": str(error)}
    found = {"seconds": round(time.perf_counter() - start, 2), "report": report.to_dict()}
    if other_metrics is not None:
        with one_thread_an_operation():
            found["other_metrics"] = other_metrics(study, report, seed)
    return found
