"""What every transform promises: format, batches, draws, copies, and the input's own bits where nothing falls."""

from __future__ import annotations

import copy
import io
import itertools
import pickle
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import torchweather as tw
from tests.contract.table import ONE_EACH, TABLE, Entry, of_image, same_bits, same_result, tensors_of, transform_of
from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.core.random import derived_seed
from torchweather.stages import Chain

in_each = pytest.mark.parametrize("name", ONE_EACH)


def agree(entry: Entry, one: Tensor, other: Tensor) -> bool:
    """Bit for bit; of images up to the order in which single precision adds."""
    return bool(torch.allclose(one, other, rtol=0.0, atol=1e-6)) if entry.apart is of_image else same_bits(one, other)


def chain_owner(transform: Any) -> Any:
    """The transform that has the chain: an `AsBayer` has it inside."""
    return getattr(transform, "transform", transform)


# ---- format ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("batch", [(), (1,), (2, 2)], ids=str)
def test_the_output_has_the_format_of_the_input(entry: Entry, transform: Any, batch: tuple[int, ...]) -> None:
    for dtype in entry.dtypes:
        given = entry.data(*batch, dtype=dtype)
        noise = transform.draw(given, seed=1)
        out, result = transform(given, noise=noise), tensors_of(transform.run(given, noise=noise))
        assert out.dtype == dtype
        assert out.shape == given.shape if not entry.more_rows else out.shape[-2] == given.shape[-2] + entry.more_rows
        assert same_bits(next(iter(result.values())), out)
        assert all(value.shape[: len(batch)] == batch for value in result.values())
        assert out.shape != given.shape or not same_bits(out, given)
        assert bool(torch.isfinite(torch.view_as_real(out) if out.is_complex() else out).all())


def test_every_dtype_sees_the_same_weather(entry: Entry, transform: Any) -> None:
    """An input is what it says; the weather on it is that on the same numbers in float32."""
    for dtype in entry.dtypes:
        given = entry.data(2, dtype=dtype)
        full = 1.0
        if entry.apart is of_image:
            white = 65535 if given.shape[-3] == 3 else 4095
            full = {torch.uint8: 255.0, torch.uint16: white}.get(dtype, 1.0)
        elif len(entry.dtypes) == 1:
            continue
        noise = transform.draw(given, seed=1)
        wanted = transform((given.double() / full).float(), noise=noise)
        off = (transform(given, noise=noise).double() / full - wanted.to(dtype if full == 1.0 else wanted.dtype)).abs()
        most = entry.apart(dtype)
        assert bool((off <= most + (0 if full > 1 else most) * wanted.double().abs()).all()), dtype


@pytest.mark.parametrize("layout", ["strided", "expanded", "transposed"])
def test_the_layout_in_memory_does_not_matter(entry: Entry, transform: Any, layout: str) -> None:
    given = entry.data(2)
    if layout == "strided":
        given = given.repeat_interleave(2, -2)[..., ::2, :]
    elif layout == "expanded":
        given = given[:1].expand(2, *given.shape[1:])
    else:
        given = given.transpose(-1, -2).contiguous().transpose(-1, -2)
    noise = transform.draw(given, seed=1)
    plain = given.clone(memory_format=torch.contiguous_format)
    assert agree(entry, transform(given, noise=noise), transform(plain, noise=noise))


@pytest.mark.parametrize("name", [name for name in TABLE if not name.startswith("RadarMap")])
@pytest.mark.parametrize("batch", [(0,), (2, 0)], ids=str)
def test_batches_of_nothing_come_back_empty(entry: Entry, transform: Any, batch: tuple[int, ...]) -> None:
    given = entry.data(*batch)
    result = tensors_of(transform.run(given))
    assert transform(given).numel() == 0
    assert all(value.shape[: len(batch)] == batch for value in result.values())


def test_inputs_are_never_changed_and_share_no_memory_with_the_output(entry: Entry, transform: Any) -> None:
    for dtype in entry.dtypes:
        given, beside = entry.data(2, dtype=dtype), entry.beside(2)
        noise = transform.draw(given, seed=1)
        tensors = {"": given, **beside, **noise}
        kept = {key: value.clone() for key, value in tensors.items()}
        out, result = transform(given, noise=noise, **beside), transform.run(given, noise=noise, **beside)
        for value in (out, next(iter(tensors_of(result).values()))):
            value.fill_(1)
        calm = entry.at(entry.calm)
        calm(given, noise=calm.draw(given, seed=1)).fill_(1)
        assert all(same_bits(value, kept[key]) for key, value in tensors.items())


# ---- batches and draws -----------------------------------------------------------------------------------------------


def test_a_batch_equals_its_samples_bit_for_bit(entry: Entry, transform: Any) -> None:
    given, beside = entry.data(2, 3), entry.beside(2, 3)
    seeds = torch.tensor([[11, 5, 7], [2**62, 0, 13]])
    together = tensors_of(transform.run(given, noise=transform.draw(given, seed=seeds), **beside))
    for place in itertools.product(range(2), range(3)):
        noise = transform.draw(given[place], seed=int(seeds[place]))
        own = {key: value[place] for key, value in beside.items()}
        alone = tensors_of(transform.run(given[place], noise=noise, **own))
        assert alone.keys() == together.keys()
        assert [key for key, value in alone.items() if not same_bits(together[key][place], value)] == []


def test_a_draw_can_be_replayed_and_sliced(entry: Entry, transform: Any) -> None:
    given = entry.data(3)
    noise = transform.draw(given, generator=torch.Generator().manual_seed(3))
    first = transform(given, noise=noise)
    assert same_bits(first, transform(given, noise=noise))
    part = {key: value[1:] for key, value in noise.items()}
    assert same_bits(first[1:], transform(given[1:], noise=part))
    assert all(value.shape[0] == 3 and value.device.type == "cpu" for value in noise.values())


def test_every_call_and_every_sample_has_its_own_draw(entry: Entry, transform: Any) -> None:
    one = entry.data()
    given = one.expand(2, *one.shape)
    first, second = transform(given), transform(given)
    assert torch.equal(first, second) != entry.random
    assert torch.equal(first[0], first[1]) != entry.random


def test_the_generator_decides_and_the_global_one_is_left_alone(entry: Entry, transform: Any) -> None:
    given = entry.data(2, 3)
    before = torch.get_rng_state()
    taken, counted = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    noise = transform.draw(given, generator=taken)
    transform(given, noise=noise)
    transform.run(given, noise=noise)
    transform(given, seed=3)
    if hasattr(transform, "on_numpy"):
        transform.on_numpy(given[0, 0].numpy(), seed=3)
    assert torch.equal(torch.get_rng_state(), before)
    torch.randint(0, 2**63 - 1, (6,), generator=counted)
    assert torch.equal(taken.get_state(), counted.get_state())
    torch.manual_seed(9)
    first = transform(given)
    torch.manual_seed(9)
    assert same_bits(transform(given), first)


def test_drawing_looks_at_shapes_only(entry: Entry, transform: Any) -> None:
    given = entry.data(2)
    one = transform.draw(given, seed=4)
    other = transform.draw(torch.zeros_like(given, dtype=entry.dtypes[-1]), seed=torch.tensor([4, 5]))
    assert one.keys() == other.keys()
    assert all(torch.equal(one[key], other[key]) for key in one)


def test_a_seed_or_a_generator_at_the_call_is_that_of_draw(entry: Entry, transform: Any) -> None:
    given = entry.data(3)
    for seed in (7, torch.tensor([11, 3, 8])):
        noise = transform.draw(given, seed=seed)
        assert same_bits(transform(given, seed=seed), transform(given, noise=noise))
    assert same_result(transform.run(given, seed=7), transform.run(given, noise=transform.draw(given, seed=7)))
    generator, other = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    first = transform(given, generator=generator)
    assert same_bits(first, transform(given, noise=transform.draw(given, generator=other)))
    assert torch.equal(first, transform(given, generator=generator)) != entry.random


# ---- copies, files, devices ------------------------------------------------------------------------------------------


def test_pickle_deepcopy_and_state_dict_give_the_same_bits(entry: Entry, transform: Any) -> None:
    given = entry.data(2)
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise=noise)
    buffer = io.BytesIO()
    torch.save(transform.state_dict(), buffer)
    buffer.seek(0)
    restored = entry.built()
    restored.load_state_dict(torch.load(buffer, weights_only=True))
    for again in (pickle.loads(pickle.dumps(transform)), copy.deepcopy(transform), restored):
        assert same_bits(again(given, noise=noise), wanted)
        assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())


def test_a_saved_chain_gives_the_same_bits(entry: Entry, transform: Any, tmp_path: Path) -> None:
    given, again = entry.data(2), copy.deepcopy(transform)
    noise = transform.draw(given, seed=1)
    chain = chain_owner(transform).chain
    chain.save(tmp_path / "weather.chain")
    chain_owner(again).chain = Chain.load(tmp_path / "weather.chain")
    assert chain_owner(again).chain.to_dict() == chain.to_dict()
    assert all(torch.equal(value, noise[key]) for key, value in again.draw(given, seed=1).items())
    assert same_result(again.run(given, noise=noise), transform.run(given, noise=noise))


def test_no_optimiser_moves_the_weather_and_no_graph_is_kept(entry: Entry, transform: Any) -> None:
    assert not list(transform.parameters())
    given = entry.data(1)
    noise = transform.draw(given, seed=1)
    kept = transform(given, noise=noise)
    assert not kept.requires_grad
    with torch.no_grad():
        assert same_bits(transform(given, noise=noise), kept)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        out = transform(given, noise=noise)
    assert same_bits(out, kept)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_a_module_moved_to_16_bits_keeps_its_tables(entry: Entry, dtype: torch.dtype) -> None:
    given, transform = entry.data(), entry.built()
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise=noise)
    around = torch.nn.Sequential(entry.built()).to(dtype)
    assert same_bits(around[0](given, noise=noise), wanted)
    if torch.float64 in entry.dtypes:
        small = around[0](given.to(dtype), noise=noise)
        assert small.dtype == dtype
        assert bool(torch.isfinite(small).all())


def test_one_module_in_double_precision_leaves_the_others_alone(entry: Entry, transform: Any) -> None:
    if torch.float64 not in entry.dtypes:
        pytest.skip("the numbers of a map have one type")
    given = entry.data()
    noise = transform.draw(given, seed=1)
    wanted = transform(given, noise=noise)
    double = entry.built().double()
    got = double(given.double(), noise=noise)
    assert got.dtype == torch.float64
    # The same beams and particles in double arithmetic; the tables are float32.
    tolerance = {"rtol": 0.0, "atol": 2e-5} if entry.apart is of_image else {"rtol": 1e-4, "atol": 1e-3}
    assert torch.allclose(got.float(), wanted, **tolerance)
    assert torch.allclose(double(given, noise=noise), wanted, **tolerance)
    assert same_bits(transform(given, noise=noise), wanted)
    assert same_bits(entry.built()(given, noise=noise), wanted)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_numpy_in_numpy_out(entry: Entry, transform: Any, dtype: Any) -> None:
    if not hasattr(transform, "on_numpy"):
        pytest.skip("images and maps come as tensors")
    given = entry.data().numpy().astype(dtype)
    kept, tensor = given.copy(), torch.from_numpy(given)
    got = transform.on_numpy(given, seed=3)
    assert got.dtype == dtype
    assert np.array_equal(given, kept)
    assert np.array_equal(got, transform(tensor, noise=transform.draw(tensor, seed=3)).numpy())
    # A simulator's callback reads its buffer in place: ``np.frombuffer`` gives what must not be written.
    read_only = np.frombuffer(given.tobytes(), dtype=dtype).reshape(given.shape)
    for layout in (read_only, np.asfortranarray(given), given[::-1][::-1]):
        assert np.array_equal(transform.on_numpy(layout, seed=3), got)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_the_device_follows_the_input(entry: Entry, transform: Any) -> None:
    given = entry.data(2)
    noise = transform.draw(given, seed=1)
    wanted = tensors_of(transform.run(given, noise=noise))
    got = tensors_of(copy.deepcopy(transform).to("cuda").run(given.to("cuda"), noise=noise))
    assert all(value.device.type == "cuda" for value in got.values())
    # Another exp and log, and additions in another order: a beam at the edge of a decision may fall on the other side.
    for key, value in wanted.items():
        near = torch.isclose(got[key].cpu(), value, rtol=1e-4, atol=2e-5 if entry.apart is of_image else 5e-3)
        assert float(near.float().mean()) >= (1.0 if entry.apart is of_image else 0.99), key


# ---- where nothing falls ---------------------------------------------------------------------------------------------


def own_part(entry: Entry, out: Tensor, given: Tensor) -> Tensor:
    """What became of the input's own rows; the weather's come behind them."""
    return out[..., : given.shape[-2], :] if entry.more_rows else out


def test_no_weather_gives_the_input_back_bit_for_bit(entry: Entry) -> None:
    transform = entry.at(entry.calm)
    for dtype in entry.dtypes:
        given = entry.data(2, dtype=dtype)
        for beside in ({}, entry.beside(2)):
            out = transform(given, **beside)
            assert same_bits(own_part(entry, out, given), given)
            assert not bool(out[..., given.shape[-2] :, :].any())


def test_samples_without_weather_stay_as_they_are_beside_others(entry: Entry) -> None:
    if entry.none is None:
        pytest.skip("the other weathers of a mixture fall still")
    given = entry.data(2)
    got = own_part(entry, entry.built(torch.tensor([entry.none, entry.intensities[0]]))(given), given)
    assert same_bits(got[0], given[0])
    assert not torch.equal(got[1], given[1])


@in_each
def test_samples_left_clear_by_chance_keep_their_bits(name: str) -> None:
    entry, seeds = TABLE[name], torch.tensor([1, 2, 3, 4, 5, 6])
    given = entry.data(6)
    found, always = entry.built(p=0.5)(given, seed=seeds), entry.built()(given, seed=seeds)
    own = own_part(entry, found, given)
    clear = [same_bits(own[place], given[place]) for place in range(6)]
    assert 0 < sum(clear) < 6
    for place in range(6):
        if not clear[place]:
            torch.testing.assert_close(found[place], always[place], rtol=1e-5, atol=1e-6)
    never = entry.make(entry.weather((entry.intensities[0], entry.intensities[0] * 1.5)), p=0.0)
    assert same_bits(own_part(entry, never(given, seed=1), given), given)
    assert same_bits(own_part(entry, never(given[0]), given[0]), given[0])


# ---- weathers --------------------------------------------------------------------------------------------------------


def test_the_same_weather_alone_in_a_mixture_and_anew_is_the_same_bit_for_bit(entry: Entry, transform: Any) -> None:
    given, weather = entry.data(2), entry.weather(entry.intensities[0])
    noise = transform.draw(given, seed=1)
    wanted = transform.run(given, noise=noise)
    for same in (weather, Mixture(*weather.parts), Mixture(*reversed(weather.parts))):
        other = transform.with_weather(same)
        assert all(torch.equal(value, noise[key]) for key, value in other.draw(given, seed=1).items())
        assert same_result(other.run(given, noise=noise), wanted)


def test_a_weather_that_does_not_happen_changes_nothing_in_a_mixture(entry: Entry, transform: Any) -> None:
    given, weather = entry.data(2), entry.weather(entry.intensities[0])
    kinds = [part.kind for part in weather.parts]
    for still in (Rain(0.0), Snow(0.0), Fog(float("inf"))):
        if still.kind in kinds:
            continue
        both = transform.with_weather(Mixture(*weather.parts, still))
        noise = both.draw(given, seed=1)
        alone = {key: noise[key] for key in transform.draw(given, seed=1)}
        wanted = own_part(entry, transform(given, noise=alone), given)
        assert agree(entry, own_part(entry, both(given, noise=noise), given), wanted)


@in_each
def test_a_weather_that_is_added_leaves_the_draw_of_the_others_as_it_was(name: str) -> None:
    entry, transform = TABLE[name], transform_of(name)
    given, parts = entry.data(2), entry.weather(entry.intensities[0]).parts
    alone = transform.draw(given, seed=1)
    both = transform.with_weather(Mixture(*parts, Snow(1.0), Fog(100.0))).draw(given, seed=1)
    assert alone.keys() <= both.keys()
    assert all(torch.equal(value, both[key]) for key, value in alone.items())


def test_an_intensity_for_each_sample_equals_separate_calls(entry: Entry) -> None:
    given = entry.data(3)
    transform = entry.built(torch.tensor(entry.intensities))
    together = tensors_of(transform.run(given, noise=transform.draw(given, seed=1)))
    for row, intensity in enumerate(entry.intensities):
        alone = entry.built(intensity)
        result = tensors_of(alone.run(given[row], noise=alone.draw(given[row], seed=1 + row)))
        assert [key for key, value in result.items() if not same_bits(together[key][row], value)] == []


@in_each
def test_intensities_have_the_shape_of_the_batch_or_one_element_or_none(name: str) -> None:
    entry, wanted = TABLE[name], transform_of(name)
    given, intensity = entry.data(2, 2), entry.intensities[0]
    noise = wanted.draw(given, seed=1)
    for shape in ((2, 2), (1,), ()):
        assert same_result(
            entry.built(torch.full(shape, intensity)).run(given, noise=noise), wanted.run(given, noise=noise)
        )
    for shape in ((3,), (2, 1)):
        with pytest.raises(ValueError, match=r"must be one value or one for each sample.*\(2,\)"):
            entry.built(torch.full(shape, intensity))(entry.data(2))


@in_each
def test_each_sample_gets_a_rate_of_its_own_the_same_in_any_batch(name: str) -> None:
    entry, seeds = TABLE[name], torch.tensor([11, 3, 8])
    given, of_range = entry.data(3), entry.weather((5.0, 50.0))
    transform = entry.make(of_range)
    whole = transform(given, seed=seeds)
    for place, seed in enumerate(seeds.tolist()):
        alone = transform(given[place], seed=seed)
        drawn = entry.make(of_range.drawn(seed))
        assert same_bits(alone, drawn(given[place], noise=drawn.draw(given[place], seed=seed)))
        torch.testing.assert_close(whole[place], alone, rtol=1e-5, atol=1e-6)


# Echoes of single particles have no gradient in the rate, nor has the phase of a cell.
@pytest.mark.parametrize("name", [name for name in TABLE if not name.startswith("Lidar") and "four" not in name])
def test_the_intensity_has_a_finite_gradient_that_is_none_where_nothing_falls(entry: Entry) -> None:
    given = entry.data(2)
    intensity = torch.tensor(
        [entry.intensities[0] if entry.none is None else entry.none, entry.intensities[0]], requires_grad=True
    )
    transform = entry.built(intensity)
    out = transform(given, noise=transform.draw(given, seed=1))
    if not out.requires_grad:
        assert not out.is_floating_point()
        return
    (torch.view_as_real(out) if out.is_complex() else out).sum().backward()
    assert intensity.grad is not None
    assert bool(torch.isfinite(intensity.grad).all())
    assert float(intensity.grad[1]) != 0.0


# ---- what is refused -------------------------------------------------------------------------------------------------


def test_unknown_keywords_are_refused(entry: Entry, transform: Any) -> None:
    given = entry.data()
    for call in (
        lambda: entry.built(severity=3),
        lambda: transform(given, severity=3),
        lambda: transform.run(given, severity=3),
        lambda: transform.draw(given, sead=3),
    ):
        with pytest.raises(TypeError, match="unexpected keyword"):
            call()


def test_what_is_no_tensor_is_refused_by_the_transform_s_name(entry: Entry, transform: Any) -> None:
    calls = (transform, transform.draw) if entry.apart is of_image else (transform, transform.run, transform.draw)
    for call in calls:
        for bad in ([[1.0, 0.0, 0.0, 1.0]], entry.data().numpy()):
            with pytest.raises(TypeError, match=f"(?s)^{type(transform).__name__}: .* must be a .*[tT]ensor.*got "):
                call(bad)


def test_noise_that_is_missing_or_of_another_input_is_refused(entry: Entry, transform: Any) -> None:
    given = entry.data(2)
    noise = transform.draw(given, seed=1)
    for key, value in noise.items():
        lacking = {name: other for name, other in noise.items() if name != key}
        with pytest.raises(ValueError, match=f"lacks {key}.*draw"):
            transform(given, noise=lacking)
        for wrong in (value[..., :-1], value[:1], value.flatten(), value[..., None]):
            with pytest.raises(ValueError, match=f"noise '{key}' must hold .* Use what draw"):
                transform(given, noise={**noise, key: wrong})
    with pytest.raises(ValueError, match=r"noise is drawn already.* Pass noise, or one of the others"):
        transform(given, noise=noise, seed=1)


def test_seed_and_generator_together_and_seeds_of_another_shape_are_refused(entry: Entry, transform: Any) -> None:
    given = entry.data(2)
    with pytest.raises(ValueError, match="either seed or generator"):
        transform.draw(given, generator=torch.Generator(), seed=1)
    with pytest.raises(ValueError, match="batch shape"):
        transform.draw(given, seed=torch.tensor([1, 2, 3]))
    with pytest.raises(TypeError, match="integer"):
        transform.draw(given, seed=1.5)


# ---- in a Compose ----------------------------------------------------------------------------------------------------


@in_each
def test_a_key_gets_what_its_transform_gives_with_the_key_s_seed(name: str) -> None:
    transform, rest = transform_of(name), object()
    given = TABLE[name].data()
    kept, before = given.clone(), (torch.get_rng_state(), random.getstate())
    out = tw.Compose({"it": transform})({"it": given, "rest": rest}, seed=11)
    wanted = transform(given, noise=transform.draw(given, seed=derived_seed(11, "it")))
    assert same_bits(out["it"], wanted)
    assert out["rest"] is rest
    assert same_bits(given, kept)
    assert torch.equal(torch.get_rng_state(), before[0])
    assert random.getstate() == before[1]
    without = tw.Compose({"it": transform}, p=0.0)({"it": given, "rest": rest}, seed=2)
    assert list(without) == ["it", "rest"]
    assert without["it"] is given


def test_banks_of_fog_are_the_same_for_two_cameras() -> None:
    banks = [{"effect": "camera.patchy_fog", "log_std": 0.8}]
    camera = TABLE["BayerFog"].built(effects=banks)
    two, image = tw.Compose({"left": camera, "right": camera}), TABLE["BayerFog"].data()
    seen = [two.run({"left": image, "right": image}, seed=seed)[1] for seed in (1, 2)]
    assert torch.equal(seen[0]["left"].transmission, seen[0]["right"].transmission)
    assert not torch.equal(seen[0]["left"].transmission, seen[1]["left"].transmission)
