"""Effects: stages that a sensor may have and a plain chain leaves out, each with parameters, an identity and a name.

A missing effect is a missing stage. An ``Effect`` says of itself what a search for it needs: its parameters with units,
bounds and typical size, where it stands in the chain, along which axes it shows, and what it can be mistaken for.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.distributions import Distribution, with_distributions
from torchweather.core.errors import InputTypeError, InputValueError, check_between, check_one_of
from torchweather.core.plugins import find_plugin, plugin_names
from torchweather.pipeline.chain import Chain
from torchweather.pipeline.registry import load_catalogue, register
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import is_exporting

__all__ = ["CAMERA_PLACES", "EFFECTS", "Effect", "Parameter", "effect_from_dict", "register_effect", "with_effects"]


LIBRARY = "torchweather."  # modules of the library's own effects
CAMERA_PLACES = ("scene", "extinction_and_airlight", "particle_veil", "exposure_control", "quantise")
"""Where effects of a camera stand, in the order of the light: in front of all stages, behind the fog, behind the
particles, behind the control of the exposure, behind the converter. What a chain lacks has its place behind the one
before."""


@dataclass(frozen=True)
class Parameter:
    """A number that an effect depends on.

    Args:
        name: of the buffer and of the constructor's argument, with its unit where it has one.
        unit: for people: ``dB``, ``m``, ``rad``, or ``1`` for a share or a factor.
        low, high: bounds, both allowed.
        scale: typical size of the departure from the identity, for the first guess and the prior; where the identity
            is infinite, a typical value.
        identity: value at which the effect does nothing; ``None`` where the parameter says only where or how, and
            another one whether.
        default: of the constructor's argument; the identity unless given.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    identity: float | None = None
    default: float | None = None

    @property
    def value(self) -> float:
        """Default of the constructor."""
        if self.default is not None:
            return self.default
        return self.low if self.identity is None else self.identity

    def first_of(self, values: Distribution, owner: object) -> float:
        """A value of a distribution, all of whose ends lie within the bounds; anything else is refused."""
        for end in values.ends():
            try:
                check_arguments(f"{type(owner).__name__}({self.name}: float)", end)
                self.tensor(end, owner)
            except (TypeError, ValueError) as error:
                raise type(error)(f"{error} It is an end of {values!r}.") from error
        return float(values.ends()[0])

    def tensor(self, value: float | Sequence[float] | Tensor, owner: object) -> Tensor:
        """A value within the bounds as float32, ``()`` or ``(B,)``; anything else is refused."""
        if isinstance(value, (list, tuple)):
            try:
                value = torch.tensor(value, dtype=torch.float32)
            except (TypeError, ValueError, RuntimeError, OverflowError) as error:
                raise InputValueError(
                    f"{type(owner).__name__}: {self.name} must be one number or one for each sample, (B,); got "
                    f"{value!r}."
                ) from error
        unit = "" if self.unit == "1" else self.unit
        check_between(self.name, value, self.low, self.high, unit=unit, owner=owner)
        found = torch.as_tensor(value, dtype=torch.float32)
        if found.ndim > 1:
            raise InputValueError(
                f"{type(owner).__name__}: {self.name} must be one number or one for each sample, (B,); got "
                f"{tuple(found.shape)}."
            )
        return found


class Effect(Stage):
    """A stage of the catalogue. A subclass declares itself and computes the fields of the state that it changes.

    At its identity an effect gives the state's own bits back. A parameter is a number, or one for each sample of the
    batch, ``(B,)``; it is a buffer of its name and may require a gradient.

    Class attributes:
        id: stable name, ``<sensor>.<effect>``.
        title: what happens, in plain words.
        term: what the literature calls it.
        arguments: the parameters, in the order of the catalogue.
        after: name of the stage of the ready-made chain that it follows; of a camera's chain, which holds what its
            weather asks for, one of ``CAMERA_PLACES``.
        rank: of several effects at one place, those of lower rank come first; those of one rank in the order of the
            catalogue.
        axes: along which it shows.
        confusable_with: id of another effect to what data would tell the two apart.
        percollect: title of the node of the PerCollECT cause tree that it belongs to, where there is one.
        reads, writes: fields of the state that it uses and changes, ``part.field``; a change of another field is an
            error where ``writes`` is given.
        needs: fields of the state without which it cannot work.
        cuts: whether it acts on all that lies within its parameter: half of what it does is no work of half of it.
        scatters: whether it makes whole frames differ from one another, so that a few of them may be off by more than
            many are on average.
        frame_density: name of the parameter by which the density of all weather differs from frame to frame, the
            standard deviation of its logarithm: the mean of a few frames is then off as if the record were.
        each_frame_anew: whether its noise is another one in each frame of a sequence.
        searched: whether the gap workflow looks for it without being asked to; what water and snow on things do is
            asked for by the weather, and searched for where it is named.
        unmodelled: quantities that it changes by an amount that no parameter gives, such as the brightness of a
            structure; names are those of the statistics of the gap workflow.
        not_simulated: such quantities that it changes in a way that it does not simulate: what they depart by beside
            it is said, and makes it no less likely.

    Example:
        >>> class LidarGainDrift(Effect):
        ...     id = "lidar.gain_drift"
        ...     title, term = "the laser grows weaker", "laser power drift"
        ...     arguments = (Parameter("loss_db", "dB", 0.0, 10.0, scale=1.0, identity=0.0),)
        ...     after, axes = "particle_returns", ("intensity",)
        ...     reads = writes = ("returns.signal",)
        ...
        ...     def changes(self, state, noise):
        ...         return {"signal": state.returns.signal * 10 ** (-0.1 * self.value("loss_db", state.returns.signal))}
        >>> LidarGainDrift(loss_db=2.0)
        LidarGainDrift(loss_db=2.0)

        ``register_effect(LidarGainDrift)`` puts it into the catalogue.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    term: ClassVar[str]
    arguments: ClassVar[tuple[Parameter, ...]]
    after: ClassVar[str]
    rank: ClassVar[int] = 0
    axes: ClassVar[tuple[str, ...]]
    confusable_with: ClassVar[Mapping[str, str]] = {}
    percollect: ClassVar[str | None] = None
    needs: ClassVar[tuple[str, ...]] = ()
    cuts: ClassVar[bool] = False
    scatters: ClassVar[bool] = False
    frame_density: ClassVar[str | None] = None
    each_frame_anew: ClassVar[bool] = False
    searched: ClassVar[bool] = True
    unmodelled: ClassVar[tuple[str, ...]] = ()
    not_simulated: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "id" in cls.__dict__:
            cls.default_name = cls.id.partition(".")[2]

    def __init__(self, **values: float | Sequence[float] | Tensor | Distribution) -> None:
        super().__init__()
        self.random: dict[str, Distribution] = {}
        """Parameters that are drawn for each sample, by name."""
        unknown = sorted(set(values) - {parameter.name for parameter in self.arguments})
        if unknown:
            known = ", ".join(f"{parameter.name} ({parameter.unit})" for parameter in self.arguments)
            raise InputTypeError(f"{type(self).__name__}: its parameters are {known}; got {', '.join(unknown)}.")
        for parameter in self.arguments:
            value = values.get(parameter.name, parameter.value)
            if isinstance(value, Distribution):
                self.random[parameter.name], value = value, parameter.first_of(value, owner=self)
            self.register_buffer(parameter.name, parameter.tensor(value, owner=self))

    def with_values(self, values: Mapping[str, Any]) -> Self:
        """The same effect with other values of parameters that ``random`` names."""
        return type(self)(**{**{one.name: getattr(self, one.name) for one in self.arguments}, **self.random, **values})

    def config(self) -> dict[str, Any]:
        """Parameters as numbers, as lists where samples differ, or as the plain values of a distribution.

        A bound that float32 rounds outwards is given as the bound itself, so that the constructor takes it again.
        """
        values = {one: getattr(self, one.name).detach().double() for one in self.arguments}
        numbers = {one.name: value.clamp(one.low, one.high).tolist() for one, value in values.items()}
        return numbers | {name: one.to_dict() for name, one in self.random.items()}

    def to_dict(self) -> dict[str, Any]:
        """Plain values: ``effect``, its id, and the parameters."""
        return {"effect": self.id, **self.config()}

    def extra_repr(self) -> str:
        """The parameters."""
        return ", ".join(f"{name}={value}" for name, value in self.config().items())

    def value(self, name: str, like: Tensor) -> Tensor:
        """A parameter in the dtype of a tensor ``(B, ...)``, shaped to broadcast over it."""
        found: Tensor = getattr(self, name).to(like)
        return _over(found, like)

    @property
    def at_identity(self) -> Tensor:
        """True where the effect does nothing, ``()`` or ``(B,)`` bool."""
        checked: list[Tensor] = [getattr(self, p.name) == p.identity for p in self.arguments if p.identity is not None]
        found = checked[0]
        for one in checked[1:]:
            found = found & one
        return found

    def forward(self, state: Any, noise: Mapping[str, Tensor]) -> Any:
        """The state after the effect."""
        for name, one in self.random.items():
            raise InputValueError(
                f"{type(self).__name__}: {name} must be a number here; got {one!r}. Give the effect to a transform "
                "(effects=[...]), which draws one for each sample."
            )
        missing = [name for name in self.needs if state.field(name) is None]
        if missing:
            raise InputValueError(
                f"{type(self).__name__}: expected a state with {', '.join(missing)}; this one has none. "
                f"{self.id} cannot be simulated without."
            )
        changes = self.changes(state, noise)
        self._check_declared(f"{state.part_of[name]}.{name}" for name in changes)
        identity = self.at_identity
        changed = {}
        for name, after in changes.items():
            before = state.field(name)
            changed[name] = after if before is None else _unless(_over(identity, after), before, after)
        return state.changed(**changed)

    def _check_declared(self, fields: Iterable[str]) -> None:
        other = sorted(set(fields) - set(self.writes))
        if other and self.writes:
            raise InputTypeError(
                f"{type(self).__name__}: it declares writes = {self.writes!r}; got a change of {', '.join(other)}. "
                "Add the field to writes."
            )

    def changes(self, state: Any, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """New values of the fields of the state that the effect changes.

        A field that was ``None`` must come out as what stands for ``None`` where the effect is at its identity. Echoes
        may be added at the end of the last dimension; where the effect is at its identity they are empty.
        """
        raise NotImplementedError


def _over(parameter: Tensor, like: Tensor) -> Tensor:
    """A tensor ``()`` or ``(B,)`` shaped to broadcast over ``(B, ...)``."""
    return parameter.reshape(-1, *(1,) * (like.ndim - 1)) if parameter.ndim and like.ndim else parameter


def _is_plain(identity: Tensor) -> bool:
    """True for one value of all samples that may be looked at: on the processor, outside of exported graphs."""
    return not is_exporting() and identity.ndim == 0 and identity.device.type == "cpu"


def _unless(identity: Tensor, before: Tensor, after: Tensor) -> Tensor:
    """The value after an effect, with the bits from before where it is at its identity, and the effect's gradient."""
    after = after.to(before.dtype)
    more = after.shape[-1] - before.shape[-1] if after.ndim else 0
    if more:
        before = torch.nn.functional.pad(before, (0, more))
    if _is_plain(identity) and not after.requires_grad and before.shape == after.shape:
        return before if bool(identity) else after
    if after.requires_grad:
        before = before.detach() + (after - after.detach())
    return torch.where(identity, before, after)


EFFECTS: dict[str, type[Effect]] = {}
"""Id to class, in the order of the catalogue."""


def register_effect(effect: type[Effect]) -> type[Effect]:
    """Put an effect into the catalogue and among the stages of saved chains; also a class decorator.

    Example:
        >>> from torchweather.lidar.effects.all import EFFECTS
        >>> EFFECTS["lidar.window_loss"].arguments[0].unit
        'dB'
    """
    if effect.id in EFFECTS and EFFECTS[effect.id].__module__ != effect.__module__:
        raise InputValueError(f"register_effect: {effect.id!r} is there already; choose another id.")
    EFFECTS[effect.id] = effect
    return register(effect)


def effect_from_dict(values: Mapping[str, Any]) -> Effect:
    """An effect from its ``to_dict``.

    Example:
        >>> from torchweather.lidar.effects.all import EFFECTS
        >>> effect_from_dict({"effect": "lidar.window_loss", "loss_db": 3.0})
        LidarWindowLoss(loss_db=3.0)
    """
    check_arguments("effect_from_dict(values: Mapping)", values)
    if not isinstance(values, Mapping):
        raise InputTypeError(f"effect_from_dict: expected a dictionary with effect and its parameters; got {values!r}.")
    load_catalogue()
    arguments = dict(values)
    name = arguments.pop("effect", None)
    if not all(isinstance(key, str) for key in arguments):
        raise InputTypeError(f"effect_from_dict: keys must be text; got {list(arguments)!r:.200}.")
    check_one_of("effect", name, [*EFFECTS, *plugin_names("effects")], owner="effect_from_dict")
    _load_effect(name)
    return EFFECTS[name](**with_distributions(arguments, owner=f"effect_from_dict: {name}"))


def _load_effect(name: str) -> None:
    """Register the effect that an installed package adds under an id; do nothing where none does."""
    plugin = find_plugin("effects", name, [one for one, kind in EFFECTS.items() if kind.__module__.startswith(LIBRARY)])
    if plugin is None:
        return
    effect = plugin.load()
    if not (isinstance(effect, type) and issubclass(effect, Effect) and getattr(effect, "id", None) == name):
        raise plugin.error(f"is no effect: expected a subclass of Effect whose id is {name!r}; got {effect!r:.200}.")
    register_effect(effect)


def with_effects(chain: Chain, effects: Iterable[Effect]) -> Chain:
    """A chain with effects put in, each in its place, by rank and then in the order of the catalogue.

    Args:
        chain: of a ready-made transform, or any that has the stages that the effects follow.
        effects: one of each kind at most.

    Example:
        >>> from torchweather.sensors import Lidar
        >>> from torchweather.stages import Chain, Detection, ToPoints
        >>> from torchweather.lidar.effects.all import LidarCrosstalk, LidarRangeNoise
        >>> sensor = Lidar(wavelength_nm=905.0)
        >>> chain = Chain({"detection": Detection(sensor), "to_points": ToPoints(sensor)})
        >>> list(with_effects(chain, [LidarCrosstalk(), LidarRangeNoise(std_m=0.02)]).stages)
        ['detection', 'range_noise', 'crosstalk', 'to_points']
    """
    check_arguments("with_effects(chain: Chain, effects: Iterable)", chain, effects)
    effects = list(effects)
    check_arguments("with_effects(effects: Sequence[Effect])", effects)
    unknown = [type(effect).__name__ for effect in effects if effect.id not in EFFECTS]
    if unknown:
        raise InputValueError(
            f"with_effects: {', '.join(unknown)} not in the catalogue, which gives the order; use register_effect."
        )
    order = list(EFFECTS)
    last: dict[str | None, str] = {}
    for effect in sorted(effects, key=lambda one: (_place(one), one.rank, order.index(one.id))):
        place = _followed(effect, chain)
        anchor = last.get(place, place)
        chain = chain.insert(effect, **({"before": next(iter(chain.stages))} if anchor is None else {"after": anchor}))
        last[place] = effect.default_name
    return chain


def _place(effect: Effect) -> int:
    return CAMERA_PLACES.index(effect.after) if effect.after in CAMERA_PLACES else 0


def _followed(effect: Effect, chain: Chain) -> str | None:
    """Name of the stage of a chain that an effect follows; ``None`` in front of all."""
    if effect.after not in CAMERA_PLACES:
        return effect.after
    there = [name for name in CAMERA_PLACES[: _place(effect) + 1] if name in chain.stages]
    return there[-1] if there else None
