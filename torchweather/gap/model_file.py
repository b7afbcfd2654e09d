"""Additions of a search to a model: effects, and an empirical stage; written to YAML and read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, overload

from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherError
from torchweather.core.schema import MAPPING, TEXT, Key, check_format, check_keys
from torchweather.core.yaml_file import dump_yaml, read_yaml
from torchweather.io import atomic_write
from torchweather.lidar.effects.empirical import Empirical
from torchweather.pipeline.effect import Effect, effect_from_dict
from torchweather.recipes.options import RecipeTransform, with_more_effects

__all__ = ["Additions", "read_model", "write_model"]

MODEL_FORMAT = "torchweather-model/1"
BEFORE = "to_points"  # stage of a LiDAR that an empirical stage stands in front of
KEYS = {
    "format": TEXT.needed,
    "effects": Key("a list of effects", lambda value: isinstance(value, list), required=True),
    "empirical": Key(f"{MAPPING.takes}, the arguments of an Empirical stage", MAPPING.fits).or_null,
}
T = TypeVar("T", bound=RecipeTransform)


@dataclass(frozen=True)
class Additions(Sequence[Effect]):
    """Additions to the ready-made chain: a sequence of the effects, with the empirical stage beside it.

    Args:
        effects: of the catalogue, found by name.
        empirical: a curve without a cause, or ``None``.
    """

    effects: tuple[Effect, ...]
    empirical: Empirical | None = None

    def __len__(self) -> int:
        """Number of effects."""
        return len(self.effects)

    @overload
    def __getitem__(self, place: int) -> Effect: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[Effect, ...]: ...
    def __getitem__(self, place: int | slice) -> Effect | tuple[Effect, ...]:
        """One of the effects."""
        return self.effects[place]

    def apply(self, model: T, *, empirical: bool = False) -> T:
        """The model with the effects, beside those that it has.

        Args:
            model: a transform for the sensor that they were found for.
            empirical: add the empirical stage of a LiDAR as well; it is valid in the range, the weather and the scenes
                that it was measured in.

        Raises:
            TypeError: the model is no transform of the library.
            ValueError: the effects are of another sensor, or there is no empirical stage.
        """
        if not isinstance(model, RecipeTransform):
            raise InputTypeError(
                "Additions.apply: expected a LidarWeather, a BayerWeather or a RadarAttenuation; got "
                f"{type(model).__name__}."
            )
        repaired = with_more_effects(model, self.effects)
        if empirical:
            if self.empirical is None or BEFORE not in repaired.chain.stages:
                raise InputValueError("Additions.apply: there is no empirical stage for it; leave empirical=False.")
            repaired.chain = repaired.chain.insert(self.empirical, before=BEFORE)
        return repaired


def write_model(path: Path, effects: Sequence[Effect], empirical: Empirical | None = None) -> None:
    """Write what is added to the ready-made chain as YAML."""
    values: dict[str, Any] = {"format": MODEL_FORMAT, "effects": [effect.to_dict() for effect in effects]}
    if empirical is not None:
        values["empirical"] = empirical.config()
    with atomic_write(path) as unfinished:
        unfinished.write_text(dump_yaml(values), encoding="utf-8")


def read_model(path: Path) -> Additions:
    """Model that ``write_model`` wrote.

    Raises:
        TorchweatherError: the file is missing, is no such file, or holds an effect that cannot be.
    """
    values = read_yaml(path, "a model written by GapReport.write")
    check_format(values, MODEL_FORMAT, str(path), "a model written by GapReport.write")
    check_keys(values, KEYS, str(path))
    listed, empirical = values["effects"], values.get("empirical")
    effects = []
    for number, one in enumerate(listed):
        try:
            effects.append(effect_from_dict(one))
        except (TypeError, ValueError) as error:
            raise TorchweatherError(f"{path}: effects[{number}]: {error}") from error
    try:
        stage = None if empirical is None else Empirical(**empirical)
    except (TypeError, ValueError) as error:
        raise TorchweatherError(f"{path}: empirical: {error}") from error
    return Additions(tuple(effects), stage)
