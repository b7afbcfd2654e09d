"""Options of a weather transform: its keyword arguments, as one frozen value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, ClassVar, Self

from torchweather.core.distributions import Distribution, distributions_in, with_drawn
from torchweather.pipeline.effect import Effect

__all__ = ["TransformOptions"]


@dataclass(frozen=True, kw_only=True, eq=False)
class TransformOptions:
    """Options that transforms of all sensors have; each sensor's class adds its own.

    A transform is built from its weather, its sensor and its options. Options may hold distributions; those that
    ``fixed`` names may not.

    Args:
        effects: effects of the sensor, or their dictionaries; each goes to its place in the chain.
        p: probability that a sample gets the weather, 0..1.
    """

    effects: Sequence[Effect | Mapping[str, Any]] = ()
    p: float = 1.0

    fixed: ClassVar[tuple[str, ...]] = ("p",)
    """Options that are one value for all samples."""
    ahead: ClassVar[tuple[str, ...]] = ("ego_speed_m_per_s",)
    """Options whose largest value needs the most room: a transform whose options are yet to be drawn takes it."""

    @property
    def random(self) -> dict[str, Distribution]:
        """Values that are drawn for each sample, by name: ``airlight``, ``effects.camera.exposure_gain.factor``."""
        return distributions_in(self.arguments())

    def with_drawn(self, values: Mapping[str, Any]) -> Self:
        """The same options with numbers in place of distributions."""
        names = dict.fromkeys(name.partition(".")[0] for name in values)
        return replace(self, **{name: with_drawn(getattr(self, name), values, name) for name in names})

    def arguments(self) -> dict[str, Any]:
        """Keyword arguments of the transform's constructor, in its order: those of the sensor first."""
        common = [one.name for one in fields(TransformOptions)]
        own = [one.name for one in fields(self) if one.name not in common]
        return {name: getattr(self, name) for name in (*own, *common)}

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Defaults by name; an option without a default is left out."""
        return {one.name: one.default for one in fields(cls) if one.default is not MISSING}
