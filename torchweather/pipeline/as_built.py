"""Record of a chain as its constructor made it: a later change cannot be carried over to another weather."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor

from torchweather.pipeline.chain import Chain

__all__ = ["AsBuilt"]


@dataclass(frozen=True, eq=False)
class AsBuilt:
    """Stages, their parameters and their buffers at the end of the constructor.

    Args:
        stages: names, in order.
        parameters: plain values of all stages.
        buffers: copies, by name.
    """

    stages: tuple[str, ...]
    parameters: dict[str, Any]
    buffers: dict[str, Tensor]

    @classmethod
    def of(cls, chain: Chain, known: Mapping[str, Tensor] | None = None) -> Self:
        """Record of a chain.

        Args:
            chain: as it was built.
            known: copies of buffers that are good already, by name.
        """
        kept = {} if known is None else known
        copies = {
            name: kept[name] if name in kept else value.detach().clone() for name, value in chain.state_dict().items()
        }
        return cls(tuple(chain.stages), chain.to_dict(), copies)

    def shared_with(self, chain: Chain, other: Chain) -> dict[str, Tensor]:
        """Copies of those buffers of the recorded chain that another chain shares with it."""
        own = chain.state_dict(keep_vars=True)
        return {
            name: self.buffers[name]
            for name, value in other.state_dict(keep_vars=True).items()
            if name in self.buffers and own.get(name) is value
        }

    def changed(self, chain: Chain) -> str:
        """Difference of a chain from the record, in words; empty where there is none."""
        if tuple(chain.stages) != self.stages:
            return f"the chain has the stages {', '.join(chain.stages)}, the transform makes {', '.join(self.stages)}"
        if chain.to_dict() != self.parameters:
            return "a stage of the chain was changed after the transform was built"
        now = chain.state_dict()
        other = [name for name, value in self.buffers.items() if not _same(value, now[name])]
        return f"{other[0].removeprefix('_stages.')} was changed after the transform was built" if other else ""


def _same(value: Tensor, now: Tensor) -> bool:
    """True where a buffer has the recorded values, wherever the transform was moved since."""
    value = value.to(now)
    if torch.equal(value, now):
        return True
    return value.shape == now.shape and bool(torch.all((value == now) | (value.isnan() & now.isnan())))
