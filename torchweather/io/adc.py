"""Raw samples of a radar's converter: cubes of chirps, channels and samples, and a repair of a common fault in them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchweather.core.arguments import check_arguments
from torchweather.core.atomic import atomic_write
from torchweather.core.errors import InputValueError, TorchweatherError, TorchweatherWarning, check_one_of
from torchweather.io.arrays import read_archive, read_array, write_archive

__all__ = ["ADC_AXES", "ADC_QUADRATURES", "AdcCube", "read_adc", "write_adc"]

ADC_AXES = ("chirp", "channel", "sample")
ADC_QUADRATURES = ("auto", "complex", "pair", "interleaved")
_CUBE_AXES = ("channel", "chirp", "sample")
_REPAIRS = ("repair", "error", "keep")
_PAIRS = (("i", "q"), ("real", "imag"))
_KEYS = ("cube", "adc")
HALF_16_BIT = 32767.0  # the largest number of a signed 16-bit word; above it stand the negative ones
FULL_16_BIT = 65536.0
Samples = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AdcCube:
    """Complex samples of a frame.

    Args:
        cube: ``(V, N_c, N_s)`` complex64: virtual channel, chirp of a transmitter, sample; in the file's unit.
        repaired: whether negative numbers had been stored as unsigned 16-bit words and were restored.
        layout: the order of the axes in the file; without ``channel`` where it has none (then V is 1).
    """

    cube: Tensor
    repaired: bool = False
    layout: tuple[str, ...] = ADC_AXES

    def __post_init__(self) -> None:
        check_arguments(
            "AdcCube(cube: Tensor, repaired: bool, layout: Sequence)",
            self.cube,
            self.repaired,
            self.layout,
        )
        object.__setattr__(self, "layout", _checked_layout(self.layout, "AdcCube"))
        if self.cube.ndim != 3 or not self.cube.is_complex() or 0 in self.cube.shape:
            raise InputValueError(
                "AdcCube: cube must be complex of shape (V, N_c, N_s) = channels, chirps, samples, none of them 0; got "
                f"{self.cube.dtype} {tuple(self.cube.shape)}."
            )
        if "channel" not in self.layout and self.cube.shape[0] > 1:
            raise InputValueError(
                f"AdcCube: layout must name the axis channel of {self.cube.shape[0]} channels; got "
                f"{', '.join(self.layout)}."
            )


def read_adc(
    path: str | os.PathLike[str],
    *,
    layout: Sequence[str] | None = None,
    quadrature: str = "auto",
    unsigned_16bit: str = "repair",
) -> AdcCube:
    """A frame of raw samples.

    Args:
        path: ``.npy``, or ``.npz`` with an array ``cube`` or ``adc`` (or a single one), or two arrays ``i`` and ``q``,
            or ``real`` and ``imag``.
        layout: order of the file's axes, `ADC_AXES` where neither this nor an array ``layout`` in the archive says
            otherwise. A file with one axis less has a single channel.
        quadrature: how I and Q are stored: ``complex`` numbers; ``pair``, a last axis of two; ``interleaved`` I, Q,
            I, Q along the samples. ``auto`` tells the first two; the third looks like real samples, so it must be said.
        unsigned_16bit: what to do where negative numbers were stored as unsigned 16-bit words (65535 for -1):
            ``repair`` subtracts 65536 from what is above 32767, of I and of Q, and warns; ``error`` refuses the file;
            ``keep`` leaves it.

    Returns:
        Numbers as float32, which holds 16-bit words exactly and rounds others to 7 digits.

    Raises:
        TorchweatherError: no array, truncated, other axes than the layout, NaN or infinity, a single sample, real
            samples, or the fault with ``unsigned_16bit="error"``.

    Note:
        The fault is taken for one where all of I and Q are whole numbers in 0..65535, some above 32767, and the
        repaired samples scatter less. Offset binary (a signal around 32768) scatters more after it and is left alone.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "frame.npz"
        >>> words = np.array([[[3, 1], [-2, 2]], [[0, -1], [5, 5]]], np.int16)  # chirp, sample, I and Q
        >>> np.savez(file, adc=words)
        >>> read_adc(file).cube
        tensor([[[ 3.+1.j, -2.+2.j],
                 [ 0.-1.j,  5.+5.j]]])
    """
    check_arguments(
        "read_adc(path: path, layout: Sequence[str] | None, quadrature: str, unsigned_16bit: str)",
        path,
        layout,
        quadrature,
        unsigned_16bit,
    )
    source = Path(path)
    check_one_of("quadrature", quadrature, ADC_QUADRATURES, owner="read_adc")
    check_one_of("unsigned_16bit", unsigned_16bit, _REPAIRS, owner="read_adc")
    wanted = None if layout is None else _checked_layout(layout, "read_adc")
    with np.errstate(invalid="ignore"):  # NaN is found below
        in_phase, in_quadrature, written = _stored(source, quadrature)
    axes = wanted or written or ADC_AXES
    if in_phase.ndim == len(axes) - 1:
        axes = tuple(axis for axis in axes if axis != "channel")
    if in_phase.ndim != len(axes) or 0 in in_phase.shape:
        raise TorchweatherError(
            f"{source}: expected a cube of axes {', '.join(axes)}, none of them 0; got {in_phase.shape}. Name the axes "
            "with layout=(...)."
        )
    if in_phase.shape[axes.index("sample")] < 2:
        raise TorchweatherError(
            f"{source}: expected 2 samples or more in a chirp, one has no range; got {in_phase.shape} as "
            f"{', '.join(axes)}. Another layout=(...), perhaps?"
        )
    faulty = unsigned_16bit != "keep" and _is_unsigned(in_phase, in_quadrature)
    if faulty:
        worst = int(max(in_phase.max(), in_quadrature.max()))
        told = (
            f"{source}: negative numbers are stored as unsigned 16-bit words (whole numbers from 0 to {worst}, in two "
            "heaps at both ends)."
        )
        if unsigned_16bit == "error":
            raise TorchweatherError(f"{told} Read it with unsigned_16bit='repair'.")
        warnings.warn(f"{told} 65536 is subtracted above 32767.", TorchweatherWarning, stacklevel=2)
        in_phase, in_quadrature = _signed(in_phase), _signed(in_quadrature)
    with np.errstate(over="ignore", invalid="ignore"):
        cube = (in_phase + 1j * in_quadrature).astype(np.complex64)
    if not bool(np.isfinite(cube).all()):
        raise TorchweatherError(f"{source}: expected finite samples; {int((~np.isfinite(cube)).sum())} are not.")
    ordered = cube.transpose([axes.index(axis) for axis in _CUBE_AXES if axis in axes])
    if "channel" not in axes:
        ordered = ordered[None]
    return AdcCube(torch.from_numpy(np.ascontiguousarray(ordered)), faulty, axes)


def write_adc(path: str | os.PathLike[str], frame: AdcCube | Tensor) -> None:
    """Write a frame as complex64, in the order of axes of its layout.

    Args:
        path: ``.npz`` (arrays ``cube`` and ``layout``, so that `read_adc` needs no more) or ``.npy`` (the cube alone).
        frame: from `read_adc`, or complex samples ``(V, N_c, N_s)``, which are written as `ADC_AXES`.

    Raises:
        ValueError: another suffix or shape.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "frame.npz"
        >>> write_adc(file, torch.ones(12, 128, 256, dtype=torch.complex64))
        >>> read_adc(file).cube.shape
        torch.Size([12, 128, 256])
    """
    check_arguments("write_adc(path: path, frame: AdcCube | Tensor)", path, frame)
    target = Path(path)
    mine = AdcCube(frame) if isinstance(frame, Tensor) else frame
    cube = mine.cube.detach().cpu().resolve_conj().to(torch.complex64).numpy()
    if "channel" not in mine.layout:
        cube = cube[0]
    axes = [axis for axis in _CUBE_AXES if axis in mine.layout]
    stored = np.ascontiguousarray(cube.transpose([axes.index(axis) for axis in mine.layout]))
    if target.suffix.lower() == ".npz":
        write_archive(target, {"cube": stored, "layout": np.array(mine.layout)})
    elif target.suffix.lower() == ".npy":
        with atomic_write(target) as unfinished, unfinished.open("wb") as file:
            np.lib.format.write_array(file, stored, allow_pickle=False)
    else:
        raise InputValueError(f"write_adc: path must end in .npz or .npy; got {target.name!r}.")


def _checked_layout(layout: Sequence[str], owner: str) -> tuple[str, ...]:
    check_arguments(f"{owner}(layout: Sequence[str])", layout)
    axes = tuple(layout)
    if sorted(axes) not in (sorted(ADC_AXES), ["chirp", "sample"]):
        raise InputValueError(
            f"{owner}: layout must name the axes {', '.join(ADC_AXES)} (or chirp and sample) once each, in the order "
            f"of the file; got {', '.join(map(str, axes))}."
        )
    return axes


def _stored(source: Path, quadrature: str) -> tuple[Samples, Samples, tuple[str, ...] | None]:
    """I and Q of a file, and the order of axes that it names."""
    layout = None
    if source.suffix.lower() == ".npz":
        arrays, _ = read_archive(source)
        lower = {name.lower(): array for name, array in arrays.items()}
        if "layout" in lower:
            names = [str(name) for name in lower.pop("layout").reshape(-1)]
            try:
                layout = _checked_layout(names, "layout")
            except ValueError as error:
                raise TorchweatherError(f"{source}: {error}") from error
        for first, second in _PAIRS:
            if first in lower and second in lower:
                pair = [_real(lower[name], source) for name in (first, second)]
                if pair[0].shape != pair[1].shape:
                    raise TorchweatherError(
                        f"{source}: expected {first} and {second} of one shape; got {pair[0].shape} and "
                        f"{pair[1].shape}."
                    )
                return pair[0], pair[1], layout
        known = [name for name in _KEYS if name in lower] or (list(lower) if len(lower) == 1 else [])
        if not known:
            raise TorchweatherError(
                f"{source}: expected an array cube or adc, or i and q, or real and imag; got {', '.join(arrays)}."
            )
        array = lower[known[0]]
    else:
        array = read_array(source, _KEYS)
    return (*_quadratures(array, quadrature, source), layout)


def _quadratures(array: npt.NDArray[Any], quadrature: str, source: Path) -> tuple[Samples, Samples]:
    """I and Q of one array."""
    if array.dtype.kind == "c" and quadrature in ("auto", "complex"):
        return array.real.astype(np.float64), array.imag.astype(np.float64)
    last = array.shape[-1] if array.ndim else 0
    if array.dtype.kind != "c" and quadrature != "complex":
        if last == 2 and quadrature in ("auto", "pair"):
            values = _real(array, source)
            return values[..., 0], values[..., 1]
        if last % 2 == 0 and last and quadrature == "interleaved":
            values = _real(array, source)
            return values[..., 0::2], values[..., 1::2]
    raise TorchweatherError(
        f"{source}: expected complex samples, or I and Q as a last axis of 2, or interleaved "
        f"(quadrature='interleaved'); got {array.dtype} {array.shape} with quadrature={quadrature!r}."
    )


def _real(array: npt.NDArray[Any], source: Path) -> Samples:
    if array.dtype.kind not in "fiu":
        raise TorchweatherError(f"{source}: expected numbers; got {array.dtype}.")
    return array.astype(np.float64)


def _is_unsigned(in_phase: Samples, in_quadrature: Samples) -> bool:
    """Check whether signed 16-bit words were stored as unsigned ones."""
    both = (in_phase, in_quadrature)
    words = all(bool(((one >= 0) & (one < FULL_16_BIT) & (one == np.rint(one))).all()) for one in both)
    if not words or not any(bool((one > HALF_16_BIT).any()) for one in both):
        return False
    return sum(float(np.var(_signed(one))) for one in both) < sum(float(np.var(one)) for one in both)


def _signed(words: Samples) -> Samples:
    return np.where(words > HALF_16_BIT, words - FULL_16_BIT, words)
