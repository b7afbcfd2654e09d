"""Stage: one physical step between the ideal and the measured data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, TypeVar

import torch
from torch import Tensor

from torchweather.core.precision import AtLeastSingle
from torchweather.core.random import Variate, draw_variates, sample_seeds

__all__ = ["Stage", "State"]


class State(Protocol):
    """Interface of all states."""

    @property
    def sizes(self) -> dict[str, int]:
        """The named sizes that variates refer to."""
        ...

    @property
    def batch(self) -> int:
        """Number of samples."""
        ...


S = TypeVar("S")


class Stage(AtLeastSingle):
    """A physical stage: parameters are buffers, drawing is apart from rendering.

    A subclass says which standard variates it needs (``variates``) and computes its output as a deterministic
    function of state and noise (``forward``). ``default_name`` is its place's name in a chain, and with it the
    name of its random streams.
    """

    default_name: ClassVar[str] = "stage"
    reads: ClassVar[tuple[str, ...]] = ()
    """Fields of the state, ``part.field``, that it uses, be it only for their shape; every stage of the catalogue
    declares them."""
    writes: ClassVar[tuple[str, ...]] = ()
    """Fields of the state that it changes, likewise."""
    each_beam_alone: ClassVar[bool] = False
    """True where a beam of a LiDAR comes out the same whatever the others are, and noise has the beams last."""
    of_the_air: ClassVar[bool] = False
    """True where all its noise belongs to the weather and not to a sensor (``air_variates``)."""

    takes_keys: ClassVar[bool] = False
    """True where its noise may hold the keys of tabulated normals in place of the numbers."""

    def variates(self) -> tuple[Variate, ...]:
        """The standard random numbers that this stage needs; none for a deterministic stage."""
        return ()

    def air_variates(self) -> tuple[Variate, ...]:
        """Those of them that belong to the weather and not to a sensor: ``Compose`` gives them to all sensors."""
        return self.variates() if self.of_the_air else ()

    def variates_at_rate(
        self, batch: int, written: frozenset[str] | None
    ) -> tuple[tuple[Variate, ...], list[bool] | None]:
        """The variates as far as the present intensities need them, and the samples that need any (``None``: all).

        Args:
            batch: number of samples.
            written: fields of the state that the other stages of the chain change; ``None`` is not known.
        """
        return self.variates(), None

    def draw(
        self,
        state: State,
        generator: torch.Generator | None = None,
        seed: int | Tensor | Sequence[int] | None = None,
        name: str | None = None,
        *,
        written: frozenset[str] | None = None,
        at_rate: bool = False,
        keyed: bool = False,
    ) -> dict[str, Tensor]:
        """Draw this stage's noise, on the CPU, keyed by (sample seed, stage name, variate name).

        Args:
            state: gives the number of samples and the sizes.
            generator, seed: of the samples.
            name: of the stage in its chain.
            at_rate: draw only what the present intensities need: the first part of a draw for any intensity.
            written: as in ``variates_at_rate``.
            keyed: give keys of tabulated normals where the stage takes them, as in ``draw_variates``.
        """
        seeds = list(seed) if isinstance(seed, Sequence) else sample_seeds((state.batch,), generator, seed)
        stage = name or self.default_name
        variates, only = self.variates_at_rate(len(seeds), written) if at_rate else (self.variates(), None)
        drawn = draw_variates(seeds, stage, variates, state.sizes, only=only, keyed=keyed and self.takes_keys)
        return {key.removeprefix(f"{stage}."): torch.from_numpy(array) for key, array in drawn.items()}

    def forward(self, state: Any, noise: Mapping[str, Tensor]) -> Any:
        """The state after this stage."""
        raise NotImplementedError

    def config(self) -> dict[str, Any]:
        """Plain constructor arguments, from which ``type(self)(**config)`` rebuilds the stage."""
        raise NotImplementedError
