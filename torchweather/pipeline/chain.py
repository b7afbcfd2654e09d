"""Chain: stages in order; drawn, run, extended, saved and loaded as one."""

from __future__ import annotations

import io
import math
import os
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchweather.core.archives import BROKEN_ARCHIVE, read_archive
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError, check_one_of
from torchweather.core.inflation import check_inflated
from torchweather.core.precision import AtLeastSingle
from torchweather.core.random import in_parallel, sample_seeds
from torchweather.core.schema import check_format, check_value, one_of, refuse_unknown
from torchweather.core.yaml_file import dump_yaml, parse_yaml
from torchweather.pipeline.registry import STAGES, load_catalogue, load_stage
from torchweather.pipeline.stage import Stage, State

__all__ = ["Chain"]

FORMAT = "torchweather-chain/1"


class Chain(AtLeastSingle):
    """Stages applied in order; a missing effect is a stage that is not in it.

    Args:
        stages: name to stage, in the order of application.

    Example:
        >>> from torchweather.stages import Quantise
        >>> list(Chain({"quantise": Quantise()}).stages)
        ['quantise']
    """

    def __init__(self, stages: Mapping[str, Stage]) -> None:
        super().__init__()
        self._stages = nn.ModuleDict(dict(stages))

    @property
    def stages(self) -> dict[str, Stage]:
        """Name to stage, in order."""
        return dict(self._stages.items())  # type: ignore[arg-type]

    def insert(
        self, stage: Stage, *, after: str | None = None, before: str | None = None, name: str | None = None
    ) -> Chain:
        """A new chain with ``stage`` put in; all other stages keep their random streams."""
        anchor = after if after is not None else before
        if (after is None) == (before is None):
            raise InputValueError("Chain.insert: give either after= or before=, the name of a stage of the chain.")
        check_one_of("stage", anchor, self.stages, owner=self)
        new_name = name or stage.default_name
        if new_name in self.stages:
            raise InputValueError(f"Chain.insert: a stage named {new_name!r} is there already; give another name=.")
        ordered: dict[str, Stage] = {}
        for known, present in self.stages.items():
            if known == before:
                ordered[new_name] = stage
            ordered[known] = present
            if known == after:
                ordered[new_name] = stage
        return Chain(ordered)

    def remove(self, name: str) -> Chain:
        """A new chain without the named stage."""
        check_one_of("stage", name, self.stages, owner=self)
        return Chain({known: stage for known, stage in self.stages.items() if known != name})

    def draw(
        self,
        state: State,
        generator: torch.Generator | None = None,
        seed: int | Tensor | None = None,
        *,
        at_rate: bool = False,
        keyed: bool = False,
    ) -> dict[str, Tensor]:
        """Noise of all stages, ``<stage>.<variate>`` to ``(B, ...)``; takes one integer per sample.

        Args:
            state: gives the number of samples and the sizes.
            generator, seed: of the samples.
            at_rate: draw only what the present intensities need, for this chain alone.
            keyed: for this call alone: keys of tabulated normals where a stage takes them.
        """
        seeds = sample_seeds((state.batch,), generator, seed)

        def drawn(name: str) -> dict[str, Tensor]:
            stage = self.stages[name]
            if at_rate:
                written = self.written_beside(name)
                found = stage.draw(state, seed=seeds, name=name, at_rate=True, written=written, keyed=keyed)
            else:
                found = stage.draw(state, seed=seeds, name=name)
            return {f"{name}.{variate}": array for variate, array in found.items()}

        shapes = [v.sample_shape(state.sizes) for stage in self.stages.values() for v in stage.variates()]
        numbers = len(seeds) * sum(math.prod(shape) for shape in shapes)
        return {key: array for part in in_parallel(drawn, list(self.stages), numbers) for key, array in part.items()}

    def written_beside(self, name: str) -> frozenset[str] | None:
        """Fields that the other stages change; ``None`` where one of them does not declare any."""
        others = [stage.writes for other, stage in self.stages.items() if other != name]
        return frozenset(field for fields in others for field in fields) if all(others) else None

    def forward(self, state: Any, noise: Mapping[str, Tensor]) -> Any:
        """The state after all stages."""
        for name, stage in self._stages.items():
            state = stage(state, self.noise_of(name, noise))
        return state

    def noise_of(self, name: str, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The noise of one stage, by the names that the stage has for it."""
        prefix = f"{name}."
        return {key.removeprefix(prefix): value for key, value in noise.items() if key.startswith(prefix)}

    def to_dict(self) -> dict[str, Any]:
        """Plain values: the class and the arguments of every stage."""
        return {
            "format": FORMAT,
            "stages": [
                {"name": name, "stage": type(stage).__name__, **stage.config()} for name, stage in self.stages.items()
            ],
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], owner: str = "Chain") -> Chain:
        """Rebuild a chain from ``to_dict``'s values."""
        check_format(values, FORMAT, owner, "a chain")
        refuse_unknown(values, ("format", "stages"), "", owner)
        load_catalogue()
        stages: dict[str, Stage] = {}
        for number, entry in enumerate(_entries(values, owner)):
            arguments = dict(entry)
            name, kind = arguments.pop("name", None), arguments.pop("stage", None)
            if not isinstance(name, str) or not name or "." in name or name in stages:
                raise TorchweatherError(
                    f"{owner}: stages[{number}]: expected a name of its own for each stage; got {name!r}."
                )
            load_stage(kind)
            check_value(kind, one_of(STAGES), owner, f"stages[{number}].stage")
            try:
                stages[name] = STAGES[kind](**arguments)
            except (TypeError, ValueError, KeyError, AttributeError) as error:
                raise TorchweatherError(f"{owner}: stages[{number}] ({name}): {error}") from error
        return cls(stages)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the chain as one zip of ``chain.yaml`` and ``state.npz``; nothing is pickled.

        The file is written under a temporary name and then renamed.
        """
        state = io.BytesIO()
        np.savez(state, **{key: value.detach().cpu().numpy() for key, value in self.state_dict().items()})
        with atomic_write(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("chain.yaml", dump_yaml(self.to_dict()))
            archive.writestr("state.npz", state.getvalue())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Chain:
        """Read what ``save`` wrote."""
        try:
            with zipfile.ZipFile(path) as archive:
                text, arrays = (_part(archive, name, path) for name in ("chain.yaml", "state.npz"))
            state = {key: torch.from_numpy(value) for key, value in read_archive(path, io.BytesIO(arrays))[0].items()}
        except BROKEN_ARCHIVE as error:
            raise TorchweatherError(f"{path}: expected a chain written by Chain.save; {error}.") from error
        values = parse_yaml(text, str(path), "a chain written by Chain.save")
        chain = cls.from_dict(values, owner=str(path))
        try:
            chain.load_state_dict(state)
        except RuntimeError as error:
            raise TorchweatherError(f"{path}: state.npz does not belong to chain.yaml: {error}") from error
        return chain


def _part(archive: zipfile.ZipFile, name: str, path: str | os.PathLike[str]) -> bytes:
    member = archive.getinfo(name)
    check_inflated(path, member.file_size, member.compress_size)
    return archive.read(member)


def _entries(values: Mapping[str, Any], owner: str) -> list[Mapping[str, Any]]:
    entries = values.get("stages")
    if not isinstance(entries, list) or not all(isinstance(entry, Mapping) for entry in entries):
        raise TorchweatherError(f"{owner}: stages must be a list of stages, each with name and stage; got {entries!r}.")
    return entries
