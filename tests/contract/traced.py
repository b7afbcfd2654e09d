"""A record of the fields of a state that each stage reads and writes while it runs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from torchweather.camera.state import CameraState
from torchweather.lidar.state import LidarState
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.state import PartedState
from torchweather.radar.power_map.cells import PowerMapState
from torchweather.radar.state import RadarState

STATES: tuple[type[PartedState], ...] = (CameraState, LidarState, RadarState, PowerMapState)


class Trace:
    """Fields as ``part.field``, by the class of the stage; what a stage inside another reads counts for both."""

    def __init__(self) -> None:
        self.reads: dict[type[Stage], set[str]] = defaultdict(set)
        self.writes: dict[type[Stage], set[str]] = defaultdict(set)
        self.runs: dict[type[Stage], int] = defaultdict(int)
        self.running: list[type[Stage]] = []

    def read(self, name: str) -> None:
        for stage in self.running:
            self.reads[stage].add(name)


@contextmanager
def traced() -> Iterator[Trace]:
    """Record every stage that runs inside the block.

    A copy of a state by ``changed`` reads every field of a part; it counts as no read.
    """
    trace = Trace()
    with pytest.MonkeyPatch.context() as patch:
        for state in STATES:
            for part, kind in state.parts.items():
                patch.setattr(kind, "__getattribute__", _reader(trace, part, state), raising=False)
        patch.setattr(PartedState, "changed", _silent(trace, PartedState.changed))
        patch.setattr(Stage, "__call__", _runner(trace, Stage.__call__))
        yield trace


def _reader(trace: Trace, part: str, state: type[PartedState]) -> Any:
    def read(self: Any, name: str) -> Any:
        if state.part_of.get(name) == part:
            trace.read(f"{part}.{name}")
        return object.__getattribute__(self, name)

    return read


def _silent(trace: Trace, method: Any) -> Any:
    def run(self: PartedState, **values: Any) -> Any:
        running, trace.running = trace.running, []
        try:
            return method(self, **values)
        finally:
            trace.running = running

    return run


def _runner(trace: Trace, call: Any) -> Any:
    def run(self: Stage, state: PartedState, *noise: Any, **options: Any) -> Any:
        trace.running.append(type(self))
        trace.runs[type(self)] += 1
        try:
            after = call(self, state, *noise, **options)
        finally:
            trace.running.pop()
        trace.writes[type(self)].update(_differing(state, after))
        return after

    return run


def _differing(before: PartedState, after: PartedState) -> set[str]:
    """Fields with another value than before."""
    pairs = ((part, name, getattr(before, part), getattr(after, part)) for name, part in before.part_of.items())
    return {
        f"{part}.{name}"
        for part, name, old, new in pairs
        if object.__getattribute__(old, name) is not object.__getattribute__(new, name)
    }
