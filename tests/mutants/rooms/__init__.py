"""The deliberate breaks, one table a room."""

from __future__ import annotations

from importlib import import_module

from tests.mutants.mutant import Mutant

NAMES = (
    "physics",
    "camera",
    "camera_depth",
    "lidar",
    "radar",
    "compose",
    "conditions",
    "io",
    "augment",
    "metrics",
    "robustness",
    "sweep",
    "validation",
    "scenes",
    "export",
    "gap",
    "report",
    "cli",
)

ROOMS: dict[str, tuple[Mutant, ...]] = {name: import_module(f"tests.mutants.rooms.{name}").MUTANTS for name in NAMES}
