"""Chain: stages put in, taken out, saved and loaded; every draw keeps its place."""

from __future__ import annotations

import pickletools
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from torchweather.atmosphere.weather import Fog, Mixture, Rain, Snow
from torchweather.core.errors import TorchweatherError
from torchweather.core.random import Variate
from torchweather.image.depth import FlatGround
from torchweather.sensors import Camera
from torchweather.stages import (
    STAGES,
    CameraState,
    Chain,
    ExtinctionAndAirlight,
    ParticleVeil,
    Quantise,
    Stage,
    register,
)
from torchweather.transforms import BayerWeather

CAMERA = Camera.from_intrinsics(300.0, 300.0, 23.5, 15.5, 48, 32, k1=-0.1, response_knots=((0.0, 0.0), (1.0, 1.0)))


@register
class Flicker(Stage):
    """A gain per frame: a random stage to put into chains. Identity: ``std=0``."""

    default_name: ClassVar[str] = "flicker"

    def __init__(self, std: float = 0.0) -> None:
        super().__init__()
        self.register_buffer("std", torch.tensor(float(std)))
        self.std: Tensor

    def config(self) -> dict[str, Any]:
        return {"std": float(self.std)}

    def variates(self) -> tuple[Variate, ...]:
        return (Variate("gain", "normal", (1, 1, 1)), Variate("row", "uniform", (1, "H", 1)))

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        return state.changed(signal=state.image.signal * (1 + self.std * noise["gain"]))


def state_of(batch: int = 2) -> CameraState:
    signal = torch.rand((batch, 1, 32, 48), generator=torch.Generator().manual_seed(0)) * 0.5
    depth = FlatGround()(CAMERA, 32, 48)
    return CameraState.of(
        signal=signal,
        depth_m=depth.expand(batch, 1, 32, 48),
        ray_per_depth=torch.ones(1, 1, 32, 48),
        cfa_index=torch.tensor([[0, 1], [1, 2]]),
        intrinsics=torch.tensor([CAMERA.intrinsics]),
    )


def chain_of(rate: float | Tensor = 20.0) -> Chain:
    return Chain(
        {
            "extinction_and_airlight": ExtinctionAndAirlight(Fog(120.0), (600.0, 530.0, 460.0), 0.7),
            "particle_veil": ParticleVeil([Rain(rate), Snow(0.5)], CAMERA, far_m=20.0, ambient=(0.7, 0.6, 0.5)),
            "quantise": Quantise(4095),
        }
    )


def test_stages_are_put_in_where_asked() -> None:
    chain = chain_of()
    assert list(chain.insert(Flicker(), after="particle_veil").stages)[2] == "flicker"
    assert list(chain.insert(Flicker(), before="particle_veil").stages)[1] == "flicker"
    assert list(chain.insert(Flicker(), before="quantise", name="lamp").stages)[2] == "lamp"
    assert list(chain.stages) == ["extinction_and_airlight", "particle_veil", "quantise"]
    assert list(chain.remove("particle_veil").stages) == ["extinction_and_airlight", "quantise"]


def test_wrong_places_and_names_are_refused() -> None:
    chain = chain_of().insert(Flicker(), before="quantise")
    with pytest.raises(ValueError, match=r"a stage named 'flicker' is there already; give another name="):
        chain.insert(Flicker(), before="quantise")
    with pytest.raises(ValueError, match=r"either after= or before="):
        chain.insert(Flicker(), before="quantise", after="quantise")
    with pytest.raises(ValueError, match=r"either after= or before="):
        chain.insert(Flicker())
    with pytest.raises(ValueError, match=r"Did you mean 'particle_veil'"):
        chain.insert(Flicker(), after="particle_vail")
    with pytest.raises(ValueError, match=r"stage must be one of"):
        chain.remove("optics")


def test_a_stage_more_or_less_leaves_all_other_draws() -> None:
    state, chain = state_of(), chain_of()
    before = chain.draw(state, seed=7)
    more = chain.insert(Flicker(), before="extinction_and_airlight").draw(state, seed=7)
    assert set(more) == set(before) | {"flicker.gain", "flicker.row"}
    assert all(torch.equal(more[key], before[key]) for key in before)
    fewer = chain.remove("extinction_and_airlight").draw(state, seed=7)
    assert all(torch.equal(fewer[key], before[key]) for key in before)


def test_two_stages_of_one_class_have_different_draws() -> None:
    chain = Chain({"first": Flicker(), "second": Flicker()})
    noise = chain.draw(state_of(), seed=7)
    assert not torch.equal(noise["first.gain"], noise["second.gain"])


def test_a_stage_draws_the_same_alone_as_in_its_chain() -> None:
    state, chain = state_of(), chain_of().insert(Flicker(), before="quantise")
    together = chain.draw(state, seed=7)
    alone = chain.stages["flicker"].draw(state, seed=7)
    assert torch.equal(alone["gain"], together["flicker.gain"])


def test_drawing_depends_on_shapes_only() -> None:
    state, chain = state_of(), chain_of()
    other = state.changed(
        signal=torch.zeros_like(state.image.signal), depth_m=torch.full_like(state.scene.depth_m, 3.0)
    )
    first, second = chain.draw(state, seed=7), chain.draw(other, seed=7)
    assert all(torch.equal(first[key], second[key]) for key in first)
    heavier = chain_of(60.0).draw(state, seed=7)
    assert all(torch.equal(first[key], heavier[key]) for key in first)


def test_one_integer_per_sample_whatever_the_number_of_stages() -> None:
    state, chain = state_of(3), chain_of().insert(Flicker(), before="quantise")
    taken, counted = torch.Generator().manual_seed(5), torch.Generator().manual_seed(5)
    chain.draw(state, taken)
    torch.randint(0, 2**63 - 1, (3,), generator=counted)
    assert torch.equal(taken.get_state(), counted.get_state())


@pytest.mark.parametrize("rate", [20.0, torch.tensor([5.0, 40.0])], ids=["number", "tensor"])
def test_a_saved_chain_gives_the_same_bits(tmp_path: Path, rate: float | Tensor) -> None:
    chain = chain_of(rate).insert(Flicker(0.1), before="quantise")
    state = state_of()
    noise = chain.draw(state, seed=7)
    chain.save(tmp_path / "chain.zip")
    loaded = Chain.load(tmp_path / "chain.zip")
    assert list(loaded.stages) == list(chain.stages)
    again = loaded.draw(state, seed=7)
    assert all(torch.equal(again[key], noise[key]) for key in noise)
    assert torch.equal(loaded(state, noise).image.signal, chain(state, noise).image.signal)


def test_fitted_parameters_are_saved(tmp_path: Path) -> None:
    chain = chain_of()
    chain.stages["particle_veil"].populations[1].rate_mm_per_h.fill_(3.0)  # type: ignore[index, union-attr, operator]
    chain.save(tmp_path / "chain.zip")
    state, noise = state_of(), chain.draw(state_of(), seed=7)
    assert torch.equal(Chain.load(tmp_path / "chain.zip")(state, noise).image.signal, chain(state, noise).image.signal)


def test_nothing_is_pickled(tmp_path: Path) -> None:
    chain_of().save(tmp_path / "chain.zip")
    with zipfile.ZipFile(tmp_path / "chain.zip") as archive:
        assert sorted(archive.namelist()) == ["chain.yaml", "state.npz"]
        text = archive.read("chain.yaml").decode()
        assert "!!python" not in text
        arrays = np.load(archive.open("state.npz"), allow_pickle=False)
        assert all(arrays[key].dtype.kind in "fiu" for key in arrays.files)
        with pytest.raises(ValueError, match=r"."):
            list(pickletools.genops(archive.read("state.npz")))


def write(path: Path, text: str, state: bytes | None = None) -> Path:
    donor = path.with_name("donor.zip")
    Chain({"quantise": Quantise()}).save(donor)
    with zipfile.ZipFile(donor) as archive:
        state = archive.read("state.npz") if state is None else state
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("chain.yaml", text)
        archive.writestr("state.npz", state)
    return path


GOOD = "format: torchweather-chain/1\nstages:\n"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("!!python/object/apply:os.system ['echo hacked']", "expected YAML with a chain written by Chain.save"),
        (
            GOOD + "- {name: a, stage: Quantise, levels: !!python/name:os.system }",
            "stages[0].levels: expected YAML with a chain written by Chain.save",
        ),
        ("[1, 2]", "format must be 'torchweather-chain/1'; got 'list'"),
        ("format: torchweather-chain/99\nstages: []", "got 'torchweather-chain/99'"),
        ("format: torchweather-chain/1", "stages must be a list"),
        ("format: torchweather-chain/1\nstages: {a: b}", "stages must be a list"),
        (GOOD + "- {name: quantise, stage: Quantize}", "Did you mean 'Quantise'"),
        (GOOD + "- {name: quantise, stage: Quantise, step: 3}", "stages[0] (quantise)"),
        (GOOD + "- {stage: Quantise}", "expected a name of its own for each stage; got None"),
        (
            GOOD + "- {name: a, stage: Quantise}\n- {name: a, stage: Quantise}",
            "expected a name of its own for each stage; got 'a'",
        ),
        (GOOD + "- {name: other, stage: Quantise}", "state.npz does not belong to chain.yaml"),
        (
            GOOD + "- {name: quantise, stage: ParticleVeil, weathers: [{kind: hail}], camera: {}}",
            "stages[0] (quantise)",
        ),
    ],
)
def test_hostile_and_broken_descriptions_are_refused(tmp_path: Path, text: str, wanted: str) -> None:
    path = write(tmp_path / "chain.zip", text)
    with pytest.raises(TorchweatherError, match=re.escape(wanted)) as caught:
        Chain.load(path)
    assert str(path) in str(caught.value)


def test_pickled_arrays_are_refused(tmp_path: Path) -> None:
    arrays = tmp_path / "state.npz"
    np.savez(arrays, **{"quantise.levels": np.array([{"a": 1}], dtype=object)})  # type: ignore[arg-type]
    path = write(tmp_path / "chain.zip", GOOD + "- {name: quantise, stage: Quantise}", arrays.read_bytes())
    with pytest.raises(TorchweatherError, match=r"allow_pickle"):
        Chain.load(path)


@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_an_error_with_its_path(tmp_path: Path, kept: float) -> None:
    whole = tmp_path / "whole.zip"
    chain_of().save(whole)
    data = whole.read_bytes()
    path = tmp_path / "cut.zip"
    path.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(TorchweatherError, match=re.escape(str(path))):
        Chain.load(path)


def test_flipped_bytes_are_an_error_or_nothing_changed(tmp_path: Path) -> None:
    whole = tmp_path / "whole.zip"
    chain_of().save(whole)
    data, good = whole.read_bytes(), Chain.load(whole)
    path = tmp_path / "flipped.zip"
    for place in range(0, len(data), max(1, len(data) // 40)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 0xFF]) + data[place + 1 :])
        try:
            loaded = Chain.load(path)
        except TorchweatherError:
            continue
        assert loaded.to_dict() == good.to_dict()  # a byte that says nothing, such as a time stamp


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(TorchweatherError, match=r"no-such\.zip"):
        Chain.load(tmp_path / "no-such.zip")


def test_a_failed_save_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "chain.zip"
    chain_of().save(path)
    before = path.read_bytes()

    def fail(self: zipfile.ZipFile, *args: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", fail)
    with pytest.raises(OSError, match="disk full"):
        chain_of(50.0).save(path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["chain.zip"]


def test_a_stage_put_into_a_transform_is_drawn_and_run() -> None:
    transform = BayerWeather(Mixture(Rain(20.0), Fog(100.0)), CAMERA, depth=20.0, airlight=0.7)
    frame = torch.full((1, 32, 48), 0.2)
    noise = transform.draw(frame, seed=3)
    plain = transform(frame, noise=noise)
    transform.chain = transform.chain.insert(Flicker(0.5), before="quantise")
    more = transform.draw(frame, seed=3)
    assert torch.allclose(transform(frame, noise=more), plain * (1 + 0.5 * more["flicker.gain"]), rtol=1e-6)
    transform.chain = transform.chain.remove("flicker")
    assert torch.equal(transform(frame, noise=noise), plain)


def test_a_class_name_is_registered_once() -> None:
    assert STAGES["Quantise"] is Quantise
    clash = type("Quantise", (Stage,), {"__module__": "elsewhere"})
    with pytest.raises(ValueError, match=r"a stage named 'Quantise' exists already"):
        register(clash)
