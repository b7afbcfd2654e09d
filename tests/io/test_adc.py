"""Raw samples: axes, ways of storing I and Q, the fault of unsigned words, and a recording that has it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchweather.core.errors import TorchweatherError, TorchweatherWarning
from torchweather.io import AdcCube, read_adc, write_adc

SHAPE = (4, 3, 8)  # chirps, channels, samples


def words(seed: int = 0, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """Complex samples of signed 16-bit words."""
    draw = np.random.default_rng(seed)
    return draw.integers(-300, 300, shape) + 1j * draw.integers(-300, 300, shape)


def unsigned(samples: np.ndarray) -> np.ndarray:
    """The fault: -1 becomes 65535."""
    return np.where(samples.real < 0, samples.real + 65536, samples.real) + 1j * np.where(
        samples.imag < 0, samples.imag + 65536, samples.imag
    )


def save(path: Path, array: np.ndarray) -> Path:
    np.save(path, array)
    return path


# ---- axes and quadratures ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "layout", [("chirp", "channel", "sample"), ("channel", "chirp", "sample"), ("sample", "channel", "chirp")]
)
def test_axes_are_put_in_order_and_written_in_that_of_the_file(tmp_path: Path, layout: tuple[str, ...]) -> None:
    samples = words()
    usual = ("chirp", "channel", "sample")
    source = save(tmp_path / "a.npy", samples.transpose([usual.index(axis) for axis in layout]).astype(np.complex64))
    found = read_adc(source, layout=layout)
    assert found.cube.dtype == torch.complex64
    assert found.cube.shape == (3, 4, 8)
    assert complex(found.cube[2, 1, 5]) == samples[1, 2, 5]
    assert not found.repaired
    write_adc(tmp_path / "b.npy", found)
    assert np.array_equal(np.load(tmp_path / "b.npy"), np.load(source))
    write_adc(tmp_path / "b.npz", found)  # names its axes
    again = read_adc(tmp_path / "b.npz")
    assert again.layout == layout
    assert torch.equal(again.cube, found.cube)


def test_a_frame_of_one_channel(tmp_path: Path) -> None:
    samples = words(1, (4, 8))
    found = read_adc(save(tmp_path / "a.npy", samples))
    assert found.cube.shape == (1, 4, 8)
    assert found.layout == ("chirp", "sample")
    assert np.array_equal(found.cube[0].numpy(), samples)
    write_adc(tmp_path / "b.npz", found)
    assert torch.equal(read_adc(tmp_path / "b.npz").cube, found.cube)
    turned = read_adc(save(tmp_path / "c.npy", samples.T), layout=("sample", "chirp"))
    assert torch.equal(turned.cube, found.cube)


@pytest.mark.parametrize("dtype", [np.int16, np.int32, np.float32, np.float64])
def test_i_and_q_as_pairs_as_arrays_and_interleaved(tmp_path: Path, dtype: type) -> None:
    samples = words(2)
    i, q = samples.real.astype(dtype), samples.imag.astype(dtype)
    expected = torch.from_numpy(samples.transpose(1, 0, 2)).to(torch.complex64)
    pair = save(tmp_path / "pair.npy", np.stack([i, q], axis=-1))
    assert torch.equal(read_adc(pair).cube, expected)
    woven = save(tmp_path / "woven.npy", np.stack([i, q], axis=-1).reshape(4, 3, 16))
    assert torch.equal(read_adc(woven, quadrature="interleaved").cube, expected)
    for number, names in enumerate((("i", "q"), ("I", "Q"), ("real", "imag"))):
        np.savez(tmp_path / f"{number}.npz", **dict(zip(names, (i, q), strict=True)), time_s=np.zeros(3))
        assert torch.equal(read_adc(tmp_path / f"{number}.npz").cube, expected)
    # Real samples would be read as half as many complex ones, if nobody asked.
    with pytest.raises(TorchweatherError, match=r"woven\.npy: expected complex samples.*quadrature='interleaved'"):
        read_adc(woven)


@pytest.mark.parametrize("key", ["cube", "adc", "frame"])
def test_an_archive_has_its_cube_under_a_known_name_or_alone(tmp_path: Path, key: str) -> None:
    np.savez(tmp_path / "a.npz", **{key: words()})
    assert read_adc(tmp_path / "a.npz").cube.shape == (3, 4, 8)
    np.savez(tmp_path / "a.npz", **{key: words(), "time_s": np.zeros(1)})
    if key == "frame":
        with pytest.raises(TorchweatherError, match=r"expected an array cube or adc.*got frame, time_s"):
            read_adc(tmp_path / "a.npz")
    else:
        assert read_adc(tmp_path / "a.npz").cube.shape == (3, 4, 8)


# ---- the fault of unsigned words -----------------------------------------------------------------------------------


@pytest.mark.parametrize("store", ["complex", "pair"])
def test_unsigned_words_are_repaired_and_said(tmp_path: Path, store: str) -> None:
    samples, broken = words(), unsigned(words())
    stored = broken if store == "complex" else np.stack([broken.real, broken.imag], axis=-1).astype(np.uint16)
    source = save(tmp_path / "a.npy", stored)
    with pytest.warns(TorchweatherWarning, match=r"a\.npy: negative numbers are stored as unsigned"):
        found = read_adc(source)
    assert found.repaired
    assert np.array_equal(found.cube.numpy(), samples.transpose(1, 0, 2))
    with pytest.raises(TorchweatherError, match=r"a\.npy: negative.*unsigned_16bit='repair'"):
        read_adc(source, unsigned_16bit="error")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kept = read_adc(source, unsigned_16bit="keep")
        write_adc(tmp_path / "b.npy", found)  # what was repaired is written whole
        assert not read_adc(tmp_path / "b.npy").repaired
    assert not kept.repaired
    assert np.array_equal(kept.cube.numpy(), broken.transpose(1, 0, 2))


@pytest.mark.parametrize(
    "samples",
    [
        words(),
        np.abs(words().real) + 1j * np.abs(words().imag),  # small whole numbers
        words() + 32768 * (1 + 1j),  # offset binary
        unsigned(words()) + 0.25,  # no whole numbers
        unsigned(words()) * 2,  # more than 16 bits
    ],
    ids=["signed", "positive", "offset", "fractions", "wide"],
)
@pytest.mark.filterwarnings("error")
def test_what_is_no_fault_is_left_alone(tmp_path: Path, samples: np.ndarray) -> None:
    found = read_adc(save(tmp_path / "a.npy", samples), unsigned_16bit="repair")
    assert not found.repaired
    assert np.array_equal(found.cube.numpy(), samples.transpose(1, 0, 2).astype(np.complex64))


# ---- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.ones((2, 3, 4, 8), complex), r"axes chirp, channel, sample.*got \(2, 3, 4, 8\)"),
        (np.ones(8, complex), r"got \(8,\)"),
        (np.ones((4, 0, 8), complex), "none of them 0"),
        (np.ones((4, 3, 1), complex), r"2 samples or more in a chirp.*got \(4, 3, 1\)"),
        (np.full(SHAPE, np.nan + 0j), "expected finite samples; 96 are not"),
        (np.full(SHAPE, 1e300 + 0j), "expected finite samples"),
        (np.ones(SHAPE), "expected complex samples"),
        (np.ones((4, 3, 8, 2), bool), "expected numbers; got bool"),
        (np.array("text"), "expected complex samples"),
    ],
)
def test_what_is_no_cube_is_refused(tmp_path: Path, array: np.ndarray, message: str) -> None:
    with pytest.raises(TorchweatherError, match=rf"a\.npy: .*{message}"):
        read_adc(save(tmp_path / "a.npy", array))


def test_wrong_arguments_and_archives_are_named(tmp_path: Path) -> None:
    source = save(tmp_path / "a.npy", words())
    with pytest.raises(ValueError, match="quadrature must be one of auto, complex, pair, interleaved"):
        read_adc(source, quadrature="iq")
    with pytest.raises(ValueError, match="unsigned_16bit must be one of repair, error, keep"):
        read_adc(source, unsigned_16bit="yes")
    for layout in (("chirp", "chirp", "sample"), ("chirp", "sample", "antenna"), ("channel", "sample")):
        with pytest.raises(ValueError, match="read_adc: layout must name the axes chirp, channel, sample"):
            read_adc(source, layout=layout)
    with pytest.raises(ValueError, match=r"cube must be complex of shape \(V, N_c, N_s\).*got torch.float32 \(2, 3\)"):
        write_adc(tmp_path / "b.npz", torch.zeros(2, 3))
    with pytest.raises(ValueError, match="layout must name the axis channel of 2 channels"):
        AdcCube(torch.zeros(2, 3, 4, dtype=torch.complex64), layout=("chirp", "sample"))
    with pytest.raises(ValueError, match=r"must end in \.npz or \.npy; got 'b\.bin'"):
        write_adc(tmp_path / "b.bin", torch.zeros(1, 3, 4, dtype=torch.complex64))
    with pytest.raises(TorchweatherError, match="no such file"):
        read_adc(tmp_path / "none.npy")
    np.savez(tmp_path / "c.npz", i=np.ones(SHAPE), q=np.ones((4, 3, 7)))
    with pytest.raises(TorchweatherError, match=r"expected i and q of one shape; got \(4, 3, 8\) and \(4, 3, 7\)"):
        read_adc(tmp_path / "c.npz")
    np.savez(tmp_path / "c.npz", cube=words(), layout=np.array(["a", "b"]))
    with pytest.raises(TorchweatherError, match=r"c\.npz: layout.*got a, b"):
        read_adc(tmp_path / "c.npz")


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
@given(data=st.data())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.filterwarnings("ignore::torchweather.core.errors.TorchweatherWarning")
def test_a_broken_file_is_refused_or_read_but_never_crashes(tmp_path: Path, name: str, data: st.DataObject) -> None:
    path = tmp_path / name
    write_adc(path, torch.from_numpy(words(3, (2, 2, 4))).to(torch.complex64))
    whole = bytearray(path.read_bytes())
    for place, value in data.draw(
        st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), min_size=1, max_size=6)
    ):
        whole[place] = value
    start = data.draw(st.integers(0, len(whole)))
    path.write_bytes(whole[:start] + whole[start + data.draw(st.sampled_from([0, 0, 1, 50])) :])
    try:
        found = read_adc(path)
    except TorchweatherError as error:
        assert name in str(error)  # noqa: PT017
    else:
        assert bool(torch.view_as_real(found.cube).isfinite().all())


def test_a_header_with_a_key_in_bytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    write_adc(path, torch.from_numpy(words(3, (2, 2, 4))).to(torch.complex64))
    whole = path.read_bytes()
    assert whole.count(b" 'shape'") == 1
    path.write_bytes(whole.replace(b" 'shape'", b"B'shape'"))
    with pytest.raises(TorchweatherError, match=r"a\.npy: expected one array"):
        read_adc(path)


def test_a_header_that_promises_a_hundred_gigabytes_is_refused_at_once(tmp_path: Path) -> None:
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"shape": (10**4, 10**3, 10**3), "fortran_order": False, "descr": "<c8"}
        )
        file.write(bytes(100))
    with pytest.raises(TorchweatherError, match=r"a\.npy: array .* needs 80000000000 bytes"):
        read_adc(tmp_path / "a.npy")


# ---- recordings ----------------------------------------------------------------------------------------------------


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "shape", "low", "high"),
    [("doppler_example_1.npy", (8, 128, 128), -234, 202), ("simple_frame_1.npy", (1, 128, 128), -148, 171)],
)
def test_a_recording_with_the_fault_is_repaired(
    real_data: Callable[[str], Path], name: str, shape: tuple[int, ...], low: int, high: int
) -> None:
    source = real_data(f"openradar_adc/{name}")
    with pytest.warns(TorchweatherWarning, match="65536 is subtracted"):
        found = read_adc(source)
    assert found.repaired
    assert found.cube.shape == shape
    assert (int(found.cube.real.min()), int(found.cube.real.max())) == (low, high)
    assert int(found.cube.imag.abs().max()) < 300  # a jump over the word's end would leave 32768 or more

    window = torch.hann_window(128, periodic=False)
    wrapped = read_adc(source, unsigned_16bit="keep").cube
    profile, broken = (torch.fft.fft(cube * window).abs().square().mean((0, 1)) for cube in (found.cube, wrapped))
    # The strongest on an indoor bench is the radar's own leakage and what stands next to it: the first bins.
    assert int(profile.argmax()) <= 2
    # A wrapped number is a step of 65536 where 100 was meant, 56 dB, and white over range: all bins rise as much.
    assert 10 * float(torch.log10(broken.median() / profile.median())) > 50


@pytest.mark.real_data
@pytest.mark.filterwarnings("ignore::torchweather.core.errors.TorchweatherWarning")
def test_noise_of_a_recording_is_complex_gaussian_after_the_repair(real_data: Callable[[str], Path]) -> None:
    """The change from chirp to chirp in range bins that nothing moves in: I and Q alike, apart, and Gaussian.

    14 bins, 64 pairs of chirps and 8 channels are n = 7168 numbers of I and of Q. Standard errors are sqrt(4/n) = 0.024
    of the ratio of variances, 1/sqrt(n) = 0.012 of the correlation and sqrt(24/n) = 0.058 of the kurtosis; the limits
    are four of them.
    """
    source = real_data("openradar_adc/doppler_example_1.npy")

    def noise(unsigned_16bit: str) -> torch.Tensor:
        spectrum = torch.fft.fft(read_adc(source, unsigned_16bit=unsigned_16bit).cube.to(torch.complex128))
        return torch.view_as_real((spectrum[:, 1::2] - spectrum[:, 0::2])[..., 6:20]).reshape(-1, 2)

    def kurtosis(values: torch.Tensor) -> float:
        return float(values.pow(4).mean() / values.square().mean().square() - 3.0)

    i, q = noise("repair").unbind(-1)
    assert float(i.var() / q.var()) == pytest.approx(1.0, abs=4 * 0.024)
    assert abs(float(torch.corrcoef(torch.stack([i, q]))[0, 1])) < 4 * 0.012
    assert max(abs(kurtosis(i)), abs(kurtosis(q))) < 4 * 0.058
    assert float(i.var()) < 1e-4 * float(noise("keep")[:, 0].var())
