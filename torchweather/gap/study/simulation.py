"""Frames as the ready-made chain simulates them: the base model of a study.

Every optional stage of the chain is at its identity unless it is asked for. A simulated frame starts from a clear frame
of the same scene that is drawn at random, and gets no sensor noise of its own: the clear frames carry it.
"""

from __future__ import annotations

from collections.abc import Sequence

from torchweather.core.random import keyed_stream
from torchweather.gap.study.study import Condition, Frame, Study
from torchweather.pipeline.effect import Effect

__all__ = ["simulate", "start_frame"]


def simulate(
    study: Study, condition: Condition, *, seed: int, number: int = 0, effects: Sequence[Effect] = ()
) -> Frame:
    """A frame of a condition as the library simulates it.

    Args:
        study: with the sensor and the clear frames.
        condition: weather, scene, and where they apply speed of the vehicle and exposure.
        seed: of the whole simulation.
        number: of the frame; each has a start frame and weather of its own.
        effects: of the catalogue, put into the chain; not for links. Start frame and weather stay the same ones.

    Returns:
        Arrays of the study's kind, as in its own frames. In clear air a clear frame itself, whatever the effects.

    Note:
        Beams without return have a direction, so particles can return there. A fluctuating record of the weather
        (``rel_sd``) is not drawn: the intensity is taken as it stands. Radar: no clutter of rain or snow beyond what
        the clear frame has. Links: the loss of rain on the way (ITU-R P.838-3) over dry samples of the same link.

    Example:
        >>> from torchweather.gap.study.embedded import embedded_study
        >>> study = embedded_study("radar", clear_frames=2, frames=1)
        >>> frame = simulate(study, study.conditions[0], seed=1)
        >>> sorted(frame)
        ['noise_floor_db', 'power_db', 'range_m', 'speed_m_per_s']
    """
    kind, drawn = study.study_kind, _stream_seed(seed, condition.id, number)
    if not kind.has_scenes:
        return kind.simulated(study, condition, condition.frames[number % len(condition.frames)], drawn, tuple(effects))
    clear = study.scene_of(condition).clear[start_frame(study, condition, seed=seed, number=number)]
    return clear if condition.weather is None else kind.simulated(study, condition, clear, drawn, tuple(effects))


def start_frame(study: Study, condition: Condition, *, seed: int, number: int = 0) -> int:
    """Position of the clear frame that ``simulate`` starts from, drawn at random."""
    count = len(study.scene_of(condition).clear)
    return int(keyed_stream(seed, f"gap.start_frame.{condition.id}.{number}").integers(count))


def _stream_seed(seed: int, condition: str, number: int) -> int:
    """Seed of the weather of one frame."""
    return int(keyed_stream(seed, f"gap.weather.{condition}.{number}").integers(2**62))
