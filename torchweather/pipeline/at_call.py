"""A weather of its own for each sample of a call: rates drawn from their ranges, some samples left clear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchweather.atmosphere.weather import Mixture, Weather
from torchweather.core.errors import InputValueError, owner_name
from torchweather.core.random import keyed_stream

__all__ = ["CLEAR", "weather_at_call"]

CLEAR = {"rate_mm_per_h": 0.0, "mor_m": math.inf}
"""Value of each intensity without weather."""


def weather_at_call(weather: Weather, p: float, batch: Sequence[int], seeds: Sequence[int], owner: object) -> Weather:
    """The weather of a call: a number, or a tensor of the batch shape, for each rate and visibility.

    Args:
        weather: with numbers, tensors or distributions.
        p: probability that a sample gets weather.
        batch: shape of the batch; ``()`` for one sample.
        seeds: one integer for each sample, row-major.
        owner: for messages.

    Raises:
        ValueError: a field that all samples of a batch share, such as a temperature, is to be drawn for each.

    Example:
        >>> from torchweather.atmosphere.weather import Rain
        >>> weather_at_call(Rain(rate_mm_per_h=(1, 50)), 0.5, (4,), [1, 2, 3, 4], "example").rate_mm_per_h > 0
        tensor([ True, False, False, False])
    """
    drawn = [weather.drawn(seed) for seed in seeds]
    conditions = _conditions(weather, drawn, p, batch, owner)
    wet = [p >= 1.0 or float(keyed_stream(seed, "weather.p").random()) < p for seed in seeds]
    parts = [
        _part(part, [one.parts[place] for one in drawn], wet, batch, owner) for place, part in enumerate(weather.parts)
    ]
    if conditions and not batch and not wet[0]:
        conditions = tuple(replace(one, **{one.intensity_name: 0.0}) for one in conditions)  # type: ignore[type-var]
    return parts[0] if len(parts) == 1 and not conditions else Mixture(*parts, *conditions)


def _conditions(
    weather: Weather, drawn: Sequence[Weather], p: float, batch: Sequence[int], owner: object
) -> tuple[Weather, ...]:
    """Water and snow on things, which all samples of a batch share."""
    if len(drawn) > 1 and weather.conditions:
        kind = weather.conditions[0].kind
        if p < 1.0:
            raise InputValueError(
                f"{owner_name(owner)}: {kind} is one for all samples of a batch, and p leaves some of them clear; got "
                f"p={p:g}. Draw the weather before the batch is made (WeatherDataset, Compose)."
            )
        for one in weather.conditions:
            for name, given in one.random.items():
                raise InputValueError(
                    f"{owner_name(owner)}: {one.kind}.{name} is one value for all samples of a batch; got {given!r}. "
                    "Draw it before the batch is made (WeatherDataset, Compose), or give a number."
                )
    return drawn[0].conditions if drawn else weather.densest().conditions


def _part(part: Weather, drawn: Sequence[Weather], wet: Sequence[bool], batch: Sequence[int], owner: object) -> Weather:
    name = part.intensity_name
    shared = [other for other in part.random if other != name]
    if shared and len(drawn) > 1:
        raise InputValueError(
            f"{owner_name(owner)}: {part.kind}.{shared[0]} is one value for all samples of a batch; got "
            f"{part.random[shared[0]]!r}. Draw it before the batch is made (WeatherDataset, Compose), or give a number."
        )
    if not drawn:
        return replace(part.densest(), **{name: torch.zeros(tuple(batch))})  # type: ignore[type-var]
    given = [getattr(one, name) for one in drawn]
    intensity: Any
    if not batch:
        intensity = given[0] if wet[0] else CLEAR[name]
    elif isinstance(given[0], Tensor):  # one value, or one for each sample: the same in each draw
        chosen = torch.tensor(wet, device=given[0].device).reshape(tuple(batch))
        intensity = torch.where(chosen, given[0].reshape(tuple(batch) if given[0].numel() > 1 else ()), CLEAR[name])
    else:
        values = [float(value) if one else CLEAR[name] for value, one in zip(given, wet, strict=True)]
        intensity = torch.tensor(values).reshape(tuple(batch))
    return replace(drawn[0], **{name: intensity})  # type: ignore[type-var]
