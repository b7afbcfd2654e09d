"""Airlight: the light that fog adds along an endless ray, estimated from a frame.

It is that of the fog near the horizon (``PHYSICS.md`` 10.7), so it is taken from the sky just above the horizon, not
from the mean of all sky, and never from surfaces.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.luminance import airlight_from_luminance
from torchweather.camera.state import CameraState
from torchweather.core.compiled import uses_compiled
from torchweather.core.errors import InputValueError, TorchweatherWarning, owner_name
from torchweather.core.masks import most_of
from torchweather.pipeline.graph_operations import cells_apart
from torchweather.pipeline.tiling import is_exporting

__all__ = [
    "AIRLIGHT_MODES",
    "DEFAULT_GREY",
    "Airlight",
    "airlight_argument",
    "estimate_airlight",
    "STRIDES_PX",
    "frame_mean",
    "per_colour",
    "scaled_airlight",
    "thinned",
]

Airlight = tuple[float, float, float] | str | None
"""Three linear signals, ``sky`` (its colour), ``grey`` (its luminance), or ``None``: grey for colour planes, whose
white balance is not known, and sky for a mosaic."""

AIRLIGHT_MODES = ("sky", "grey")
# The sky is estimated on every fourth row, so that the lowest sky is met, and every sixteenth column of each colour.
STRIDES_PX = (4, 16)
BAND_SINE = math.sin(math.radians(3.0))
"""Sine of the elevation over which the weight of sky pixels falls by e, from the lowest sky of the frame: skylines hide
the lowest degrees, and a clear sky darkens within some ten."""
REC709 = (0.2126, 0.7152, 0.0722)  # luminance of linear sRGB, ITU-R BT.709
# A blue sky's light is darker than that of a fog lit by it and the sun, and an overexposed sky says nothing: neutral
# 0.5 to 0.7 looks right on photographs (chosen by eye; measured airlight goes to airlight=). A grey sky, overcast or
# misty, is lit as fog is: it keeps its own light. Between them the lower bound rises with the sky's saturation.
GREY_RANGE = (0.5, 0.7)
BLUE_SATURATION = 0.3  # of 21 street scenes, blue skies have 0.28 to 0.65, grey and overexposed ones 0.00 to 0.16
DEFAULT_GREY = 0.6
DAYLIGHT_ABOVE = 0.05  # linear luminance of a horizon sky by day; below, the sky's own light is kept
# A picture's horizon is seen through kilometres of its own air: fog whose optical depth over this way is small adds the
# light that is there already; fog that is opaque over it has its own.
OWN_AIR_M = 5000.0
BRIGHTEST_ROWS = 64  # an even number, of a band that stays in the cache
NIGHT_BELOW = 0.02  # share of saturation: a sky darker than this is night


LUMINANCE = ("luminance_cd_per_m2", "iso", "f_number", "exposure_s", "lens_factor")
"""Keys of an airlight that is given as a luminance with its exposure."""


def airlight_argument(value: Sequence[float] | float | str | Mapping[str, float] | None, owner: object) -> Airlight:
    """The argument ``airlight=`` checked: a mode, or three numbers in 0..1.

    One number, (red, green, blue), or the arguments of `airlight_from_luminance` as a mapping become three numbers.
    """
    if value is None:
        return None
    if isinstance(value, str):
        if value not in AIRLIGHT_MODES:
            raise InputValueError(
                f"{owner_name(owner)}: airlight must be one of {', '.join(AIRLIGHT_MODES)}, one number or (red, green, "
                f"blue) in 0..1, linear; got {value!r}."
            )
        return value
    if isinstance(value, Mapping):
        if not {*LUMINANCE[:4]} <= {*value} <= {*LUMINANCE}:
            raise InputValueError(
                f"{owner_name(owner)}: airlight as a luminance must have the keys {', '.join(LUMINANCE[:4])} and may "
                f"have {LUMINANCE[4]}; got {', '.join(map(str, value)) or 'none'}."
            )
        value = airlight_from_luminance(**value)
    try:
        values = (float(value),) * 3 if isinstance(value, (int, float)) else tuple(float(v) for v in value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        values = ()
    if len(values) != 3 or not all(0.0 <= v <= 1.0 for v in values):
        raise InputValueError(
            f"{owner_name(owner)}: airlight must be one number or (red, green, blue) in 0..1, linear, in units of "
            f"saturation; got {value!r}."
        )
    return values


def estimate_airlight(
    state: CameraState, owner: object, mode: str | None = None, extinction_per_m: Tensor | None = None
) -> Tensor:
    """Airlight per colour, ``(B, 3)``, from the sky just above the horizon.

    Where a frame shows no sky, a grey of 0.6 (colour planes; at night its mean light) or the brightest 3 x 3
    neighbourhood of each colour (mosaics, whose exposure is not known) stands in, with a warning.

    Args:
        state: the frame.
        owner: named in warnings.
        mode: ``sky`` or ``grey``; ``None`` is grey for colour planes and sky for a mosaic.
        extinction_per_m: ``(B, 3)`` of the fog: as it tends to 0, grey tends to the sky's own light, so that thin fog
            leaves a sky at the horizon as it is.
    """
    planes = state.receiver.cfa_index is None
    light, seen = _horizon_sky_at_once(state) if is_exporting() else _horizon_sky(state, STRIDES_PX)
    if not is_exporting() and not bool(seen.all()) and _any_sky(state):
        # A sky may show between the thinned pixels only.
        every, seen_at_all = _horizon_sky(state, (1, 1) if planes else (2, 2))
        light, seen = torch.where(seen, light, every), seen | seen_at_all
    grey = mode == "grey" or (mode is None and planes)
    if grey:
        neutral = _neutral(light)
        own = 0.0 if extinction_per_m is None else own_air(extinction_per_m.to(light))
        light = neutral + own * (light - neutral)
    airlight = light
    if is_exporting() or not bool(seen.all()):
        instead = _grey_without_sky(state) if planes else per_colour(_brightest(state), state)
        if grey and not planes:
            instead = instead.mean(1, keepdim=True).expand_as(light)
        airlight = torch.where(seen, light, instead)
    if not is_exporting() and state.image.signal.numel():
        _warn(airlight, seen, owner, planes=planes, night=state.air.lamp_light is not None)
    return airlight


def own_air(extinction_per_m: Tensor) -> Tensor:
    """Share of the fog's light at a picture's horizon that is the picture's own, ``exp(-5 km alpha)``, as shaped."""
    return torch.exp(-OWN_AIR_M * extinction_per_m)


def _grey_without_sky(state: CameraState) -> Tensor:
    """Stand-in for the airlight of a picture without a sky, ``(B, 3)``: a grey by day, the mean light at night."""
    mean = (frame_mean(state) * state.image.signal.new_tensor(REC709)).sum(1, keepdim=True)
    return torch.where(mean < NIGHT_BELOW, mean, DEFAULT_GREY).expand(-1, 3)


def _warn(airlight: Tensor, seen: Tensor, owner: object, *, planes: bool, night: bool) -> None:
    if not bool(seen.all()):
        day = bool((airlight[~seen[:, 0]].amax(1) >= NIGHT_BELOW).any())
        stands_in = "the brightest spot" if not planes else f"a grey of {DEFAULT_GREY:g}" if day else "its mean light"
        warnings.warn(
            f"{type(owner).__name__}: no sky in the frame and no airlight given; {stands_in} stands in for it. Give "
            "airlight=(red, green, blue), linear, in units of saturation.",
            TorchweatherWarning,
            stacklevel=4,
        )
    if not night and bool((airlight.amax(1) < NIGHT_BELOW).any()):
        warnings.warn(
            f"{type(owner).__name__}: the sky, or a picture without one, is darker than {NIGHT_BELOW:g} of saturation; "
            "this looks like night. Give night=True (or a Night with its lamps), or airlight= if this is day.",
            TorchweatherWarning,
            stacklevel=4,
        )


def _horizon_sky(state: CameraState, steps_px: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Sky's light per colour ``(B, 3)``, weighted towards the horizon, from some rows and columns; and whether every
    colour was seen, ``(B, 1)``."""
    given, depth_m, sky = state.scene.sky, state.scene.depth_m, None
    if given is not None:
        sky = thinned(state, given, steps_px)
    elif most_of(_rows_with(state, depth_m, steps_px[0])) == torch.inf:
        sky = torch.isinf(thinned(state, depth_m, steps_px))
    if sky is None or not bool(sky.any()):  # the other maps need not be read
        unseen = torch.zeros(state.batch, 1, dtype=torch.bool, device=depth_m.device)
        return state.image.signal.new_zeros(state.batch, 3), unseen
    sky = sky.to(state.image.signal.dtype)
    signal = thinned(state, state.image.signal, steps_px)  # (B, 4 or 3, n)
    weight = sky
    if state.scene.sine_elevation is not None:
        weight = towards_horizon(sky, thinned(state, state.scene.sine_elevation, steps_px).to(signal.dtype))
    weight = weight.expand(len(signal), weight.shape[1], -1)
    seen = (sky > 0.5).any(-1).all(1, keepdim=True).expand(len(signal), 1)
    light = (signal * weight).sum(-1) / weight.sum(-1).clamp_min(1e-12)
    return per_colour(light.view(-1, 2, 2), state) if state.receiver.cfa_index is not None else light, seen


def _rows_with(state: CameraState, image: Tensor, down: int) -> Tensor:
    """The rows of an image that ``thinned`` takes of every ``down``: whole rows are read fast."""
    if state.receiver.cfa_index is None:
        return image[..., ::down, :]
    height, width = image.shape[-2:]
    return image.reshape(-1, height // 2, 2, width)[:, :: down // 2]


def _horizon_sky_at_once(state: CameraState) -> tuple[Tensor, Tensor]:
    """``_horizon_sky`` of some rows and columns, or of all of them where those show no sky; as a graph holds it.

    Both have the same sums: what is left out has no weight.
    """
    signal = state.image.signal
    planes = state.receiver.cfa_index is None
    given = state.scene.sky
    sky = (torch.isinf(state.scene.depth_m) if given is None else given).to(signal.dtype)
    few = torch.where(_picked(signal, 1 if planes else 2), sky, 0.0)
    sky = torch.where(_seen(few, planes=planes)[:, :, None, None], few, sky)
    weight = sky
    if state.scene.sine_elevation is not None:
        weight = towards_horizon(sky, state.scene.sine_elevation.to(signal.dtype))
    if planes:
        light = (signal * weight).sum((2, 3)) / weight.sum((2, 3)).clamp_min(1e-12)
    else:
        sums = [cells_apart(one).sum((2, 3)) for one in (signal * weight, weight)]
        light = per_colour(sums[0] / sums[1].clamp_min(1e-12), state)
    return light, _seen(sky, planes=planes)


def _picked(image: Tensor, cell_px: int) -> Tensor:
    """Mask ``(H, W)`` of the pixels that ``thinned`` takes by ``STRIDES_PX``."""
    place = [torch.arange(size, device=image.device, dtype=image.dtype) for size in image.shape[-2:]]
    down, across = (torch.fmod(at, step) < cell_px for at, step in zip(place, STRIDES_PX, strict=True))
    return down.unsqueeze(1) & across


def _seen(sky: Tensor, *, planes: bool) -> Tensor:
    """True where every phase of a mosaic, or a pixel of planes, shows sky, ``(B, 1)``; of ``(B, 1, H, W)``."""
    most = sky.amax((2, 3)) if planes else cells_apart(sky).amax((2, 3)).amin(1, keepdim=True)
    return most > 0.5


def towards_horizon(sky: Tensor, sine_elevation: Tensor) -> Tensor:
    """Weight of each pixel for the airlight: its share of sky, falling by e for each 3 degrees above the lowest sky.

    Args:
        sky: ``(B, ...)`` share of sky.
        sine_elevation: of the rays, broadcast against it.
    """
    sine = sine_elevation.clamp_min(0.0)
    lowest = torch.where(sky > 0.5, sine, 2.0).amin(tuple(range(1, sky.ndim)), keepdim=True)
    return sky * torch.exp(((lowest - sine) / BAND_SINE).clamp_max(0.0))


def thinned(state: CameraState, image: Tensor, steps_px: tuple[int, int]) -> Tensor:
    """Every so many rows and columns of each phase of a mosaic, ``(B, 4, n)``, or of each plane, ``(B, C, n)``."""
    down, across = steps_px
    if state.receiver.cfa_index is None:
        return image[..., ::down, ::across].flatten(2)
    some = _phases(image, down // 2, across // 2)
    return some.reshape(*some.shape[:2], some.shape[2] * some.shape[3])  # flatten has more operations in a graph


def _phases(mosaic: Tensor, down: int = 1, across: int = 1) -> Tensor:
    """Planes ``(B, 4, rows, columns)`` of the phases of a mosaic ``(B, 1, H, W)``.

    Args:
        mosaic: the raw frame.
        down, across: from one row and column of cells that is taken to the next.
    """
    if is_exporting() and down == across == 1:
        return cells_apart(mosaic)
    b, _, height, width = mosaic.shape
    cells = mosaic.reshape(b, height // 2, 2, width // 2, 2)[:, ::down, :, ::across]
    rows, columns = cells.shape[1], cells.shape[3]
    return cells.permute(0, 2, 4, 1, 3).reshape(b, 4, rows, columns)


def _neutral(light: Tensor) -> Tensor:
    """Grey of the luminance of a horizon sky, ``(B, 3)``; by day of a blue one within `GREY_RANGE`."""
    luminance = (light * light.new_tensor(REC709)).sum(1, keepdim=True)
    brightest = light.amax(1, keepdim=True)
    saturation = (brightest - light.amin(1, keepdim=True)) / brightest.clamp_min(1e-6)
    lowest = GREY_RANGE[0] * (saturation / BLUE_SATURATION).clamp_max(1.0)
    by_day = luminance.clamp_max(GREY_RANGE[1]).maximum(lowest)
    return torch.where(luminance > DAYLIGHT_ABOVE, by_day, luminance).expand_as(light)


def _any_sky(state: CameraState) -> bool:
    if state.scene.sky is not None:
        return bool(state.scene.sky.amax() > 0.5)
    return most_of(state.scene.depth_m) == torch.inf


def _brightest(state: CameraState) -> Tensor:
    """Mean of the brightest 3 x 3 neighbourhood of each phase of the CFA, ``(B, 2, 2)``; at the edges of fewer.

    Of a graph ``(B, 4)``.
    """
    signal = state.image.signal
    if is_exporting() or min(signal.shape[-2:]) < 8:
        return _brightest_of(signal)
    if _is_compiled(signal):
        from torchweather.camera.compiled_airlight import brightest_cells

        return torch.from_numpy(np.stack([brightest_cells(one[0].contiguous().numpy()) for one in signal.detach()]))
    # Neighbours of one phase are two rows or columns apart, so that all phases add up together.
    found = [_edge(_pooled(signal[..., :4, :])[..., 0, :]), _edge(_pooled(signal[..., -4:, :])[..., -1, :])]
    found += [_edge(_pooled(signal[..., :4])[..., 0]), _edge(_pooled(signal[..., -4:])[..., -1])]
    height = signal.shape[-2]
    for first in range(0, height - 4, BRIGHTEST_ROWS):
        band = signal[:, 0, first : min(first + BRIGHTEST_ROWS, height - 4) + 4]
        down = band[:, :-4] + band[:, 2:-2] + band[:, 4:]
        both = down[..., :-4] + down[..., 2:-2]
        both = both + down[..., 4:]
        columns = torch.stack([both[:, y::2].amax(1) for y in (0, 1)], 1)  # (B, 2, W - 4)
        found.append(torch.stack([columns[..., x::2].amax(-1) for x in (0, 1)], -1) / 9)
    return torch.stack(found).amax(0)


def _is_compiled(signal: Tensor) -> bool:
    learns = torch.is_grad_enabled() and signal.requires_grad
    return signal.device.type == "cpu" and signal.dtype == torch.float32 and not learns and uses_compiled()


def _pooled(signal: Tensor) -> Tensor:
    """Means of the 3 x 3 neighbourhoods of each phase, ``(B, 4, H / 2, W / 2)``."""
    return torch.nn.functional.avg_pool2d(_phases(signal), 3, stride=1, padding=1, count_include_pad=False)


def _edge(means: Tensor) -> Tensor:
    """Brightest along an edge, ``(B, 4, n)`` to ``(B, 2, 2)``."""
    return means.amax(-1).view(-1, 2, 2)


def _brightest_of(signal: Tensor) -> Tensor:
    most = _pooled(signal).amax((-2, -1))
    return most if is_exporting() else most.view(-1, 2, 2)


def per_colour(cells: Tensor, state: CameraState) -> Tensor:
    """Mean over the cells of each colour, ``(B, 2, 2)`` or ``(B, 4)`` to ``(B, 3)``."""
    cfa = state.receiver.cfa_index
    assert cfa is not None
    own = (cfa.flatten() == torch.arange(3, device=cfa.device)[:, None]).to(cells.dtype)  # (3, 4)
    if is_exporting():
        shares = own / own.sum(-1, keepdim=True).clamp_min(1)
        return (cells if cells.ndim == 2 else cells.flatten(1)) @ shares.T
    return (cells.reshape(-1, 1, 4) * own).sum(-1) / own.sum(-1).clamp_min(1)


def frame_mean(state: CameraState) -> Tensor:
    """Mean signal of each colour over the frame, ``(B, 3)``."""
    if state.receiver.cfa_index is None:
        return state.image.signal.mean((-2, -1))
    if is_exporting():
        return per_colour(cells_apart(state.image.signal).mean((2, 3)), state)
    signal = state.by_cells(state.image.signal)  # (B, 1, H/2, 2, W)
    even, odd = signal[..., 0::2].mean((1, 2, 4)), signal[..., 1::2].mean((1, 2, 4))  # (B, 2)
    return per_colour(torch.stack([even, odd], -1), state)


def scaled_airlight(airlight: Tensor, state: CameraState) -> Tensor:
    """Airlight ``(B, 3)`` in the light that the state says, up to saturation."""
    return airlight if state.air.airlight_scale is None else (airlight * state.air.airlight_scale).clamp_max(1.0)


def given_or_estimated(
    given: Airlight, state: CameraState, owner: object, extinction_per_m: Tensor | None = None
) -> Tensor:
    """Airlight ``(B, 3)``: the given signals, or an estimate of the given mode for fog of an extinction."""
    if given is None or isinstance(given, str):
        return estimate_airlight(state, owner, given, extinction_per_m)
    return state.image.signal.new_tensor(given).expand(state.batch, 3)
