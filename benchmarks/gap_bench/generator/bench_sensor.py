"""What a bench of hidden effects needs of a kind of sensor: its cases, how each is made, and the bars.

The truth of a case is a dictionary that ``scoring`` reads:

- ``id, family, weather, options``: of the case; ``options`` has ``screen`` where the global test alone counts and
  ``decoy``.
- ``effects``: a list of what is hidden, each with ``name`` (``lidar.window_loss``, or ``outside.`` and a name that the
  catalogue does not have), ``parameters``, ``same_form`` (the catalogue's own), ``level`` (d'), ``identifiable``,
  ``confusable_with`` (effect to cosine) and ``axes`` (words of the right axis, of an outside effect).
- ``right``: of a decoy, ``verdicts`` and ``names`` that are right.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from torchweather.gap import GapReport
from torchweather.gap.study.study import Study

from ..bars import Bar

__all__ = ["SENSORS", "BenchCase", "BenchSensor", "OtherMetrics", "bench_sensor"]

Made = tuple[Study, dict[str, Any]]
"""A study and its truth."""

OtherMetrics = Callable[[Study, GapReport, int], Mapping[str, Mapping[str, float]]]
"""Gaps before and after on metrics that no search uses, of a study, its report and a seed."""


class BenchCase(Protocol):
    """One study to be made."""

    @property
    def id(self) -> str:
        """Of its folder; says nothing about what is hidden."""
        ...


@dataclass(frozen=True)
class BenchSensor:
    """A kind of sensor.

    Args:
        groups: names of the groups of cases that there are.
        usual: those that make a full set, without the screen.
        plan: ``(set name, seed, groups, small)`` to the cases, in an order that does not depend on which groups are
            asked for; ``small`` is the size for tests.
        builder: ``(set name, seed, sealed folder, cases, few)`` to what makes a case. What took long to compute, such
            as strengths, may be kept in the sealed folder; ``few`` leaves out what those cases do not need.
        bars: what the figures must reach.
        floors: held-out gap after over its floor, up to which it counts as near.
        other_metrics: none where there are none.
    """

    groups: Sequence[str]
    usual: Sequence[str]
    plan: Callable[[str, int, Sequence[str], bool], Sequence[BenchCase]]
    builder: Callable[[str, int, Path, Sequence[Any], bool], Callable[[Any], Made]]
    bars: Sequence[Bar]
    floors: float
    other_metrics: OtherMetrics | None = None


SENSORS = ("lidar", "camera", "radar")
"""Names of the folders beside this module; ``cases.py`` in each has its ``SENSOR``."""


def bench_sensor(name: str) -> BenchSensor:
    """The sensor of a bench by its name; its modules are loaded when it is asked for."""
    sensor: BenchSensor = importlib.import_module(f".{name}.cases", __package__).SENSOR
    return sensor
