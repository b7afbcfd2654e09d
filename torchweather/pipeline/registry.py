"""Names of the stage classes, so that a chain can be read back from YAML without a pickle."""

from __future__ import annotations

from typing import TypeVar

from torchweather.pipeline.stage import Stage

__all__ = ["STAGES", "register"]

STAGES: dict[str, type[Stage]] = {}
T = TypeVar("T", bound=type[Stage])


def register(stage: T) -> T:
    """Class decorator: make a stage known under its class name, for saved chains.

    Example:
        >>> from torchweather.stages import STAGES
        >>> "ParticleVeil" in STAGES
        True
    """
    if stage.__name__ in STAGES and STAGES[stage.__name__].__module__ != stage.__module__:
        raise ValueError(f"register: a stage named {stage.__name__!r} exists already; choose another class name.")
    STAGES[stage.__name__] = stage
    return stage
