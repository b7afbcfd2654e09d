"""A minimal image signal processor: raw numbers to linear light and back, balance, colour, tone, companding.

Linear light is a float with 0 at the black level and 1 at saturation. Every function is pure and differentiable
except the rounding in `quantise`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import torch
from torch import Tensor

from torchweather.camera.bayer import cfa_index, colour_means
from torchweather.camera.demosaic import demosaic
from torchweather.core.arguments import check_arguments, check_broadcast
from torchweather.core.errors import InputTypeError, InputValueError, check_between, check_one_of
from torchweather.core.precision import outside_autocast

__all__ = [
    "colour_matrix",
    "compand",
    "develop",
    "expand",
    "grey_world_gains",
    "normalise",
    "quantise",
    "shoulder_curve",
    "srgb_decode",
    "srgb_encode",
    "white_balance",
]

LEAST_LEVELS = 1e-9  # between black and white, over white: less is no step of any number
_FULL_SCALE = {torch.uint8: 255.0, torch.uint16: 65535.0, torch.int16: 32767.0, torch.int32: 2147483647.0}


def normalise(
    raw: Tensor,
    black_level: float = 0.0,
    white_level: float | None = None,
    *,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Linear light of raw numbers: ``(raw - black) / (white - black)``; 0 is black, 1 saturation.

    Args:
        raw: any shape; ``uint8``, ``uint16``, ``int16``, ``int32`` or float.
        black_level: raw number without light, in the units of ``raw``.
        white_level: raw number at saturation. Default: the largest of an integer dtype, 1.0 for float.
        dtype: of the result where ``raw`` is an integer; a float keeps its own.

    Returns:
        The shape of ``raw``. Below black the result is negative: read noise around black must keep its mean.

    Example:
        >>> normalise(torch.tensor([64, 1023], dtype=torch.int16), 64, 1023)
        tensor([0., 1.])
    """
    check_arguments(
        "normalise(raw: Tensor, black_level: float, white_level: float | None, dtype: dtype)",
        raw,
        black_level,
        white_level,
        dtype,
    )
    black, white = _levels(raw.dtype, black_level, white_level, "normalise")
    linear = raw if raw.is_floating_point() else raw.to(dtype)
    if black == 0.0 and white == 1.0:
        return linear
    return (linear - black) / (white - black)


def quantise(
    linear: Tensor,
    dtype: torch.dtype,
    black_level: float = 0.0,
    white_level: float | None = None,
) -> Tensor:
    """Raw numbers of linear light: the inverse of `normalise`, rounded to the nearest and clipped.

    Args:
        linear: any shape, float; 0 is black, 1 saturation.
        dtype: ``uint8``, ``uint16``, ``int16``, ``int32``, or a float type (neither rounded nor clipped then).
        black_level: raw number without light.
        white_level: raw number at saturation. Default: the largest of an integer dtype, 1.0 for float.

    Returns:
        The shape of ``linear`` in ``dtype``; an integer lies in 0..white level. Integers up to 16 bits that came
        through `normalise` in float32 come back exactly.

    Example:
        >>> quantise(torch.tensor([-0.5, 0.5, 2.0]), torch.uint8)
        tensor([  0, 128, 255], dtype=torch.uint8)
    """
    check_arguments(
        "quantise(linear: floating, dtype: dtype, black_level: float, white_level: float | None)",
        linear,
        dtype,
        black_level,
        white_level,
    )
    black, white = _levels(dtype, black_level, white_level, "quantise")
    raw = linear if black == 0.0 and white == 1.0 else linear * (white - black) + black
    if dtype.is_floating_point:
        return raw.to(dtype)
    return raw.round().clamp(0.0, white).to(dtype)


def white_balance(rgb: Tensor, gains: Tensor | Sequence[float]) -> Tensor:
    """Colours scaled so that grey looks grey: ``rgb * gains``.

    Args:
        rgb: ``(..., 3, H, W)``, linear in light.
        gains: ``(3,)`` or ``(..., 3)``: factors of red, green, blue.

    Returns:
        ``(..., 3, H, W)``, not clipped.

    Example:
        >>> white_balance(torch.full((3, 1, 1), 0.25), (2.0, 1.0, 1.5)).flatten()
        tensor([0.5000, 0.2500, 0.3750])
    """
    check_arguments("white_balance(rgb: floating(..., 3, H, W), gains: real | Sequence[float])", rgb, gains)
    factors = torch.as_tensor(gains, dtype=rgb.dtype, device=rgb.device)
    check_arguments("white_balance(gains: floating(..., 3))", factors)
    check_between("gains", factors, -1e6, 1e6, owner="white_balance")
    check_broadcast("white_balance", rgb=rgb.new_empty(rgb.shape[:-2]), gains=factors)
    return rgb * factors[..., None, None]


def grey_world_gains(bayer: Tensor, pattern: str) -> Tensor:
    """Gains that make the mean of the frame grey, green held at 1.

    Args:
        bayer: mosaic ``(..., 1, H, W)``, linear in light, H and W even.
        pattern: one of `torchweather.image.PATTERNS`.

    Returns:
        ``(..., 3)`` factors of red, green (or clear), blue; 1 where a colour is black.

    Note:
        A frame in fog has other means than the clear one. To compare the two, take the gains of one for both.

    Example:
        >>> grey_world_gains(torch.tensor([[[0.2, 0.4], [0.4, 0.1]]]), "RGGB")
        tensor([2., 1., 4.])
    """
    check_arguments("grey_world_gains(bayer: Tensor, pattern: str)", bayer, pattern)
    means = colour_means(bayer, pattern)
    return torch.where(means > 0, means[..., 1:2] / means.clamp_min(torch.finfo(means.dtype).tiny), 1.0)


@outside_autocast
def colour_matrix(rgb: Tensor, matrix: Tensor | Sequence[Sequence[float]]) -> Tensor:
    """Colours in another set of primaries: ``out_i = sum_j matrix_ij rgb_j`` per pixel.

    Args:
        rgb: ``(..., 3, H, W)``, linear in light.
        matrix: ``(3, 3)``; rows that sum to 1 keep grey grey.

    Returns:
        ``(..., 3, H, W)``, not clipped.

    Example:
        >>> swap = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
        >>> colour_matrix(torch.tensor([0.1, 0.2, 0.3])[:, None, None], swap).flatten()
        tensor([0.3000, 0.2000, 0.1000])
    """
    check_arguments("colour_matrix(rgb: floating(..., 3, H, W), matrix: Quantity)", rgb, matrix)
    try:
        weights = torch.as_tensor(matrix, dtype=rgb.dtype, device=rgb.device)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputTypeError(f"colour_matrix: matrix must be numbers, (3, 3); got {matrix!r:.100}.") from error
    check_arguments("colour_matrix(matrix: floating(3, 3))", weights)
    check_between("matrix", weights, -1e6, 1e6, owner="colour_matrix")
    return torch.einsum("ij,...jhw->...ihw", weights, rgb)


def srgb_encode(linear: Tensor) -> Tensor:
    """Display values of linear light by the sRGB transfer function.

    Args:
        linear: any shape, float, clipped to [0, 1].

    Returns:
        The shape of ``linear``, in [0, 1].

    References:
        IEC 61966-2-1:1999.

    Example:
        >>> srgb_encode(torch.tensor([0.0, 0.0031308, 0.2140, 1.0]))
        tensor([0.0000, 0.0404, 0.5000, 1.0000])
    """
    check_arguments("srgb_encode(linear: floating)", linear)
    linear = linear.clamp(0.0, 1.0)
    # The power's base is held above zero: its gradient at 0 is infinite, and would turn into NaN in the unused branch.
    curved = 1.055 * linear.clamp_min(0.0031308) ** (1.0 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, curved)


def srgb_decode(display: Tensor) -> Tensor:
    """Linear light of sRGB display values; the inverse of `srgb_encode`.

    Args:
        display: any shape, float, clipped to [0, 1].

    Returns:
        The shape of ``display``, in [0, 1].

    References:
        IEC 61966-2-1:1999.

    Example:
        >>> srgb_decode(torch.tensor([0.0, 0.5, 1.0]))
        tensor([0.0000, 0.2140, 1.0000])
    """
    check_arguments("srgb_decode(display: floating)", display)
    display = display.clamp(0.0, 1.0)
    curved = ((display.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(display <= 0.04045, display / 12.92, curved)


def shoulder_curve(linear: Tensor, knee: float = 1.0) -> Tensor:
    """Tone curve that bends highlights towards 1 instead of clipping them.

    ``y = x`` up to the knee ``k``, ``y = k + (1 - k) (1 - exp(-(x - k) / (1 - k)))`` above: smooth, rising, below 1.

    Args:
        linear: any shape, float.
        knee: where the bend starts, in [0, 1]; 1 clips at 1 and bends nothing.

    Returns:
        The shape of ``linear``; at most 1.

    Example:
        >>> shoulder_curve(torch.tensor([0.5, 0.8, 4.0]), knee=0.8)
        tensor([0.5000, 0.8000, 1.0000])
    """
    check_arguments("shoulder_curve(linear: floating, knee: float)", linear, knee)
    check_between("knee", knee, 0.0, 1.0, owner="shoulder_curve")
    if knee == 1.0:
        return linear.clamp_max(1.0)
    room = 1.0 - knee
    return torch.where(linear <= knee, linear, knee - room * torch.expm1(-(linear - knee).clamp_min(0.0) / room))


def compand(linear: Tensor, knots: Sequence[tuple[float, float]]) -> Tensor:
    """Codes of a sensor that compresses its range by a piecewise-linear curve before transmission.

    Args:
        linear: light, any shape, float, in the unit of the knots' first numbers.
        knots: ``(light, code)`` pairs, both strictly rising, two or more; usually from the sensor's data sheet.

    Returns:
        Codes, the shape of ``linear``. Above the last knot the sensor is saturated and gives its code; below the
        first one the first line is continued, so that noise around black survives.

    Example:
        >>> twelve_bit = [(0.0, 0.0), (2048.0, 2048.0), (65536.0, 3072.0), (1048576.0, 4095.0)]
        >>> compand(torch.tensor([1000.0, 65536.0, 2e6]), twelve_bit)
        tensor([1000., 3072., 4095.])
    """
    check_arguments("compand(linear: floating, knots: Sequence)", linear, knots)
    return _piecewise_linear(linear, _checked_knots(knots, "compand"))


def expand(raw: Tensor, knots: Sequence[tuple[float, float]]) -> Tensor:
    """Linear light of a companding sensor's codes; the inverse of `compand`.

    Args:
        raw: codes, any shape, float, in the unit of the knots' second numbers.
        knots: the ``(light, code)`` pairs given to `compand`.

    Returns:
        Light, the shape of ``raw``; codes above the last knot give its light.

    Example:
        >>> twelve_bit = [(0.0, 0.0), (2048.0, 2048.0), (65536.0, 3072.0), (1048576.0, 4095.0)]
        >>> expand(torch.tensor([1000.0, 3072.0, 4095.0]), twelve_bit)
        tensor([1.0000e+03, 6.5536e+04, 1.0486e+06])
    """
    check_arguments("expand(raw: floating, knots: Sequence)", raw, knots)
    return _piecewise_linear(raw, [(code, light) for light, code in _checked_knots(knots, "expand")])


@outside_autocast
def develop(
    bayer: Tensor,
    pattern: str,
    *,
    black_level: float = 0.0,
    white_level: float | None = None,
    knots: Sequence[tuple[float, float]] | None = None,
    gains: Tensor | Sequence[float] | str = (1.0, 1.0, 1.0),
    matrix: Tensor | Sequence[Sequence[float]] | None = None,
    exposure: float = 1.0,
    knee: float = 1.0,
    method: str = "malvar",
) -> Tensor:
    """Display image of a raw frame, in one call.

    Order: black and white level, expand the companding, exposure and white balance on the mosaic (so that the
    demosaicing sees balanced colours), clip at saturation (a clipped highlight stays white), demosaic, colour matrix,
    shoulder, sRGB.

    Args:
        bayer: ``(..., 1, H, W)``; ``uint8``, ``uint16``, ``int16``, ``int32`` or float.
        pattern: one of `torchweather.image.PATTERNS`.
        black_level: raw number without light.
        white_level: raw number at saturation. Default: the largest of an integer dtype, 1.0 for float.
        knots: ``(light, code)`` pairs of a companding sensor between the two levels, from (0, 0) to (1, 1), as
            `torchweather.Camera.response_knots`. Default: the sensor is linear.
        gains: factors of red, green (or clear), blue, ``(3,)`` or ``(..., 3)``; ``"grey_world"`` takes those of
            `grey_world_gains`. Default: none.
        matrix: ``(3, 3)`` from the sensor's colours to linear sRGB. Default: none.
        exposure: factor of everything.
        knee: of `shoulder_curve`. Default: clip.
        method: of `torchweather.image.demosaic`.

    Returns:
        ``(..., 3, H, W)`` float in [0, 1], sRGB-encoded.

    Example:
        >>> develop(torch.full((1, 4, 4), 13700, dtype=torch.uint16), "RGGB").mean((-2, -1)).round(decimals=2)
        tensor([0.4900, 0.4900, 0.4900])
    """
    check_arguments(
        "develop(bayer: real(..., 1, H, W), pattern: str, black_level: float, white_level: float | None, "
        "knots: Sequence | None, gains: real | Sequence[float] | str, matrix: Quantity | None, "
        "exposure: float, knee: float, method: str)",
        bayer,
        pattern,
        black_level,
        white_level,
        knots,
        gains,
        matrix,
        exposure,
        knee,
        method,
    )
    linear = normalise(bayer, black_level, white_level)
    if knots is not None:
        linear = expand(linear, knots)
    if isinstance(gains, str):
        check_one_of("gains", gains, ["grey_world"], owner="develop")
        gains = grey_world_gains(linear, pattern)
    factors = torch.as_tensor(gains, dtype=linear.dtype, device=linear.device) * (
        exposure if isinstance(exposure, Tensor) else float(exposure)
    )
    if factors.shape[-1:] != (3,):
        raise InputValueError(
            f"develop: gains must have shape (..., 3) = red, green, blue; got {tuple(factors.shape)}."
        )
    index = cfa_index(linear.shape[-2], linear.shape[-1], pattern, linear.device)
    balanced = (linear * factors[..., index].unsqueeze(-3)).clamp_max(1.0)
    rgb = demosaic(balanced, pattern, method)
    if matrix is not None:
        rgb = colour_matrix(rgb, matrix)
    return srgb_encode(shoulder_curve(rgb, knee))


def _levels(dtype: torch.dtype, black: float, white: float | None, owner: str) -> tuple[float, float]:
    if not dtype.is_floating_point and dtype not in _FULL_SCALE:
        raise InputTypeError(f"{owner}: raw data must be uint8, uint16, int16, int32 or float; got {dtype}.")
    full = 1.0 if dtype.is_floating_point else _FULL_SCALE[dtype]
    check_arguments(f"{owner}(black_level: float, white_level: float | None)", black, white)
    black, white = float(black), full if white is None else float(white)
    check_between("black_level", black, -1e9, 1e9, owner=owner)
    check_between("white_level", white, -1e9, 1e10, owner=owner)
    if not (math.isfinite(black) and math.isfinite(white) and white - black > LEAST_LEVELS * max(1.0, abs(white))):
        raise InputValueError(
            f"{owner}: white_level must be above black_level, both in raw units; got black_level={black!r} and "
            f"white_level={white!r}."
        )
    if not dtype.is_floating_point and white > full:
        raise InputValueError(f"{owner}: white_level must fit {dtype} (at most {full:g}); got {white!r}.")
    return black, white


def _checked_knots(knots: Sequence[tuple[float, float]], owner: str) -> list[tuple[float, float]]:
    try:
        pairs = [(float(light), float(code)) for light, code in knots]
    except (TypeError, ValueError, OverflowError, RuntimeError):
        pairs = []
    finite = all(math.isfinite(one) for pair in pairs for one in pair)
    if len(pairs) < 2 or not finite or any(b[0] <= a[0] or b[1] <= a[1] for a, b in itertools.pairwise(pairs)):
        raise InputValueError(
            f"{owner}: knots must be two or more (light, code) pairs, both strictly rising; got {list(knots)!r}."
        )
    return pairs


def _piecewise_linear(x: Tensor, knots: list[tuple[float, float]]) -> Tensor:
    """Sum of clamped ramps: elementwise, so that it exports and differentiates."""
    y = torch.full_like(x, knots[0][1])
    for n, ((x0, y0), (x1, y1)) in enumerate(itertools.pairwise(knots)):
        low = -math.inf if n == 0 else 0.0
        y = y + (x - x0).clamp(low, x1 - x0) * ((y1 - y0) / (x1 - x0))
    return y
