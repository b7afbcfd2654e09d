"""Effects of radar in the form in which they are searched for: cross sections by class, interference at many
levels, clutter in steps that fit the radar.

References:
    ``effect_forms.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.gap.inference.config import METHOD
from torchweather.gap.inference.effect_forms import SearchForm
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.radar.effects.all import RadarInterference, RadarMultipath, RadarVolumeClutter, RadarWetRcs
from torchweather.radar.state import RadarState

__all__ = ["InterferenceForm", "multipath_form", "volume_clutter_form", "wet_rcs_form"]

MOST_STRUCK = 0.95  # of the frames, by an interferer
GAIN = RadarWetRcs.arguments[0]


def wet_rcs_form(classes: Sequence[int]) -> type[Effect]:
    """``radar.wet_rcs`` with a parameter ``gain_db_<class>`` for each class of target of a study.

    Args:
        classes: 0 or more, different.

    Example:
        >>> form = wet_rcs_form([0, 2])
        >>> form(gain_db_2=1.5).to_dict()
        {'effect': 'radar.wet_rcs', 'gain_db': [0.0, 0.0, 1.5]}
    """

    class WetRcsByClass(SearchForm):
        """One gain for each class."""

        id: ClassVar[str] = RadarWetRcs.id
        title: ClassVar[str] = RadarWetRcs.title
        term: ClassVar[str] = RadarWetRcs.term
        arguments: ClassVar[tuple[Parameter, ...]] = tuple(
            Parameter(f"gain_db_{one}", "dB", GAIN.low, GAIN.high, scale=GAIN.scale, identity=0.0) for one in classes
        )
        after: ClassVar[str] = RadarWetRcs.after
        axes: ClassVar[tuple[str, ...]] = RadarWetRcs.axes
        confusable_with: ClassVar[Mapping[str, str]] = RadarWetRcs.confusable_with
        complexity_penalty: ClassVar[float] = METHOD.parameter_penalty * (len(classes) - 1)

        def to_dict(self) -> dict[str, Any]:
            """As the catalogue's effect."""
            gains = [0.0] * (max(classes) + 1)
            for one in classes:
                gains[one] = float(getattr(self, f"gain_db_{one}"))
            return {"effect": self.id, "gain_db": gains}

        def changes(self, state: RadarState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
            """Gains by class."""
            gains = self.to_dict()["gain_db"]
            return RadarWetRcs(gain_db=torch.tensor(gains)).changes(state, noise)

    return WetRcsByClass


def volume_clutter_form(size: float) -> type[Effect]:
    """``radar.volume_clutter`` whose typical share is a matter of the study: what its radar detects depends steeply on
    how far its noise floor lies below the echoes of the rain.

    Args:
        size: typical share.
    """
    share = RadarVolumeClutter.arguments[0]

    class VolumeClutterForm(RadarVolumeClutter, SearchForm):
        """The same, moved by other steps."""

        arguments: ClassVar[tuple[Parameter, ...]] = (replace(share, scale=size),)
        cuts: ClassVar[bool] = True  # of half the echo nothing may be left above the threshold

    return VolumeClutterForm


def multipath_form(size: float) -> type[Effect]:
    """``radar.multipath`` whose typical amplitude is a matter of the study: below that of the ghost that the strongest
    target needs to be detected nothing is seen, and no derivative leads there.

    Args:
        size: typical amplitude.
    """
    amplitude, delay_m = RadarMultipath.arguments

    class MultipathForm(RadarMultipath, SearchForm):
        """The same, moved by other steps."""

        arguments: ClassVar[tuple[Parameter, ...]] = (replace(amplitude, scale=size), delay_m)
        cuts: ClassVar[bool] = True  # of half the amplitude nothing may be left above the threshold
        # In the middle of each octave in which ghosts are counted: from one to the next no derivative leads.
        tried: ClassVar[Mapping[str, tuple[float, ...]]] = {"delay_m": (1.1, 2.3, 4.5, 9.0, 18.0)}
        # A few targets have a ghost above the threshold, in every frame or in none: a decibel decides which.
        unmodelled: ClassVar[tuple[str, ...]] = ("ghost_count", "clutter_count")

    return MultipathForm


class InterferenceForm(RadarInterference, SearchForm):
    """``radar.interference``, tried at levels of all sizes. One that strikes every frame is ``radar.noise_floor``."""

    another_from: ClassVar[Mapping[str, float]] = {"probability": MOST_STRUCK}
    complexity_penalty: ClassVar[float] = METHOD.parameter_penalty
    tried: ClassVar[Mapping[str, tuple[float, ...]]] = {"level_db": (0.2, 0.6, 2.0, 6.0, 18.0)}
