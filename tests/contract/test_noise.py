"""Noise from a user: what another draw, another transform or a mistake made is refused with its key."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.contract.table import ONE_EACH, TABLE, same_bits, transform_of

BATCH = (1, 2)
each = pytest.mark.parametrize("name", [name for name in ONE_EACH if TABLE[name].random])


def drawn(name: str) -> tuple[Tensor, dict[str, Tensor]]:
    data = TABLE[name].data(*BATCH)
    return data, transform_of(name).draw(data, seed=5)


def ends(noise: dict[str, Tensor]) -> list[str]:
    """The first key and the last: of the first stage and of another one."""
    keys = list(noise)
    return list(dict.fromkeys((keys[0], keys[-1])))


def called(name: str, data: Tensor, noise: Any) -> Tensor:
    out: Tensor = transform_of(name)(data, noise=noise, **TABLE[name].beside(*BATCH))
    return out


@each
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_none_is_refused(name: str, value: float) -> None:
    data, noise = drawn(name)
    for key in ends(noise):
        broken = noise[key].clone()
        broken.view(-1)[-1] = value
        with pytest.raises(ValueError, match=rf"noise '{key}' must be finite numbers of the law"):
            called(name, data, {**noise, key: broken})


@each
@pytest.mark.parametrize("dtype", [torch.bool, torch.int64, torch.complex64])
def test_other_types_are_refused(name: str, dtype: torch.dtype) -> None:
    data, noise = drawn(name)
    for key in ends(noise):
        with pytest.raises(TypeError, match=rf"noise '{key}' must be a floating-point tensor; got {dtype}"):
            called(name, data, {**noise, key: noise[key].to(dtype)})
        with pytest.raises(TypeError, match="must be a floating-point tensor; got ndarray"):
            called(name, data, {**noise, key: noise[key].numpy()})


@each
def test_other_shapes_are_refused(name: str) -> None:
    data, noise = drawn(name)
    for key in ends(noise):
        value = noise[key]
        turned = value.transpose(0, 1)  # of as many samples, in another order
        for other in (turned, value[..., :-1]):
            with pytest.raises(ValueError, match=rf"noise '{key}' must hold .* for each sample of the batch \(1, 2\)"):
                called(name, data, {**noise, key: other})


@each
def test_noise_of_another_transform_is_refused(name: str) -> None:
    data, noise = drawn(name)
    key = next(iter(noise))
    with pytest.raises(ValueError, match=rf"the noise is of another transform: it lacks {key}"):
        called(name, data, {other: value for other, value in noise.items() if other != key})
    assert same_bits(called(name, data, noise), called(name, data, {**noise, "spray.toss": noise[key]}))
    with pytest.raises(TypeError, match="noise must be a mapping of names to tensors; got list"):
        called(name, data, list(noise.values()))


@each
def test_uniforms_stay_within_their_law(name: str) -> None:
    data, noise = drawn(name)
    transform = transform_of(name)
    chain = getattr(transform, "transform", transform).chain
    laws = {f"{stage}.{one.name}": one.law for stage, some in chain.stages.items() for one in some.variates()}
    for key in (key for key, law in laws.items() if "normal" not in law):
        for value in (-0.01, 2.5):
            broken = noise[key].clone()
            broken.view(-1)[0] = value
            if laws[key] == "exponential" and value > 0:
                continue
            with pytest.raises(ValueError, match=rf"noise '{key}' must be finite numbers of the law '{laws[key]}'"):
                called(name, data, {**noise, key: broken})


@each
def test_samples_in_one_row_are_taken(name: str) -> None:
    data, noise = drawn(name)
    flat = {key: value.flatten(0, 1) for key, value in noise.items()}
    assert same_bits(called(name, data, noise), called(name, data, flat))
