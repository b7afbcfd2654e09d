"""Names of the stage classes, so that a chain can be read back from YAML without a pickle."""

from __future__ import annotations

import importlib
import re
from typing import TypeVar

from torchweather.core.errors import InputValueError
from torchweather.core.plugins import plugins
from torchweather.pipeline.stage import Stage

__all__ = ["STAGES", "load_catalogue", "load_stage", "register"]

STAGES: dict[str, type[Stage]] = {}
# Importing it registers the stages and effects of all sensors. It lies above this room and is found by its name, so
# that a chain or an effect can be read from a file in a process that has loaded no sensor yet.
CATALOGUE = "torchweather.stages"


def load_catalogue() -> None:
    """Register the stages and effects of all sensors."""
    importlib.import_module(CATALOGUE)


def load_stage(name: object) -> None:
    """Register the effect of an installed package whose class has a name; do nothing where none has."""
    for owners in plugins("effects").values():
        for plugin in owners:
            # The text behind the last point or colon: a value that is no entry point has no other parts.
            if name in STAGES or re.split(r"[.:]", plugin.entry.value)[-1] != name:
                continue
            stage = plugin.load()
            if not (isinstance(stage, type) and issubclass(stage, Stage)):
                raise plugin.error(f"is no effect: expected a subclass of Effect; got {stage!r:.200}.")
            register(stage)


T = TypeVar("T", bound=type[Stage])


def register(stage: T) -> T:
    """Class decorator: make a stage known under its class name, for saved chains.

    Example:
        >>> from torchweather.stages import STAGES
        >>> "ParticleVeil" in STAGES
        True
    """
    if stage.__name__ in STAGES and STAGES[stage.__name__].__module__ != stage.__module__:
        raise InputValueError(f"register: a stage named {stage.__name__!r} exists already; choose another class name.")
    STAGES[stage.__name__] = stage
    return stage
