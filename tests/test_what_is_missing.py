"""The command that says what a new effect lacks: nothing in this tree, every place for an effect of no place."""

from __future__ import annotations

from typing import ClassVar

import pytest

from tests import what_is_missing
from torchweather.lidar.effects import all as catalogue
from torchweather.stages import EFFECTS, Effect, Parameter


class LidarNowhere(Effect):
    """An effect that no place follows."""

    id: ClassVar[str] = "lidar.nowhere"
    title: ClassVar[str] = "nothing is known of it"
    term: ClassVar[str] = "none"
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("loss_db", "dB", 0.0, 10.0, scale=1.0, identity=0.0),)
    after: ClassVar[str] = "detection"
    axes: ClassVar[tuple[str, ...]] = ("intensity",)


def test_nothing_is_missing_and_a_new_effect_lacks_each_place(monkeypatch: pytest.MonkeyPatch) -> None:
    library = [name for name, kind in EFFECTS.items() if kind.__module__.startswith("torchweather.")]
    assert not [line for line in what_is_missing.of_effects() if line.partition(":")[0] in library]
    assert not list(what_is_missing.of_presets())
    monkeypatch.setitem(EFFECTS, LidarNowhere.id, LidarNowhere)
    monkeypatch.setattr(what_is_missing, "CONTRACTS", {"lidar": what_is_missing.CONTRACTS["lidar"]})
    found = "\n".join(line for line in what_is_missing.of_effects() if line.startswith(LidarNowhere.id))
    assert "LidarNowhere" not in catalogue.__all__
    for place in ("__all__", "CATALOGUE", "ACTIVE", "order", "each_beam_alone", "section", "PICTURES", "nowhere.png"):
        assert place in found
