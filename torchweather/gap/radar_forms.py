"""Effects of radar in the form in which they are searched for: cross sections by class, interference by its level.

References:
    ``effect_forms.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.gap.effect_forms import SearchForm
from torchweather.stages.effects import Effect, Parameter
from torchweather.stages.effects_radar import RadarInterference, RadarWetRcs
from torchweather.stages.states import RadarState

__all__ = ["InterferenceByLevel", "wet_rcs_form"]

A_PARAMETER = 5.0  # misfit that a further one must be worth: 97 % of the squares of one that explains nothing
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
        handicap: ClassVar[float] = A_PARAMETER * (len(classes) - 1)

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


class InterferenceByLevel(RadarInterference, SearchForm):
    """``radar.interference`` that grows from a level of 0 dB.

    A floor that is a little higher in some frames is nearer to none than one that is much higher in a few. At a
    probability of 1 it is ``radar.noise_floor``.
    """

    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("probability", "1", 0.0, 1.0, scale=0.2, default=0.3),
        Parameter("level_db", "dB", 0.0, 40.0, scale=3.0, identity=0.0),
    )
    handicap: ClassVar[float] = A_PARAMETER
