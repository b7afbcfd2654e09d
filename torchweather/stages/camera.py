"""Camera stages of a continuous medium and of the output: extinction with airlight, quantisation."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchweather.errors import TorchweatherWarning, check_one_of, owner_name
from torchweather.physics import KnobTable, extinction_from_mor, extinction_per_m
from torchweather.physics.d34 import table13
from torchweather.sensors import Camera
from torchweather.stages.by_rows import by_rows, is_exporting
from torchweather.stages.registry import register
from torchweather.stages.stage import Stage
from torchweather.stages.states import CameraState, by_cells
from torchweather.weather import REHEARSE, REHEARSE_MOR_M, Fog, weather_from_dict

__all__ = ["ExtinctionAndAirlight", "Quantise", "estimate_airlight"]

MOR_LOW_M, MOR_HIGH_M, MOR_NODES = 5.0, 20000.0, 96
REHEARSE_RANGE_M = (float(REHEARSE_MOR_M[0]), float(REHEARSE_MOR_M[-1]))
OPAQUE = 80.0  # optical depth that leaves nothing to see; beyond it float32 turns subnormal and slow
OPAQUE_TRANSMISSION = 2.0 * math.exp(-OPAQUE)  # reported as 0
FARTHEST_M = 1e12  # stands for an infinite depth, so that zero extinction times it is zero
NIGHT_BELOW = 0.02  # share of saturation: a sky darker than this is night, which is not modelled
SKY_STRIDE = 8  # the sky is estimated on every eighth CFA cell in each direction
FADING_COLOUR = 1  # where one colour stands for all: green, or clear
EXTINCTION_MODELS = ("mie", "koschmieder")


def _sky_mean(state: CameraState, stride: int) -> tuple[Tensor, Tensor]:
    """Mean sky of each phase of the CFA, ``(B, 2, 2)``, from every ``stride``-th cell, and whether seen, ``(B,)``."""
    step = 2 * stride
    rows = [
        [
            (state.signal[:, 0, y::step, x::step], state.depth_m[:, 0, y::step, x::step].expand(state.batch, -1, -1))
            for x in (0, 1)
        ]
        for y in (0, 1)
    ]
    signal = torch.stack([torch.stack([cell[0].flatten(1) for cell in row], 1) for row in rows], 1)
    depth = torch.stack([torch.stack([cell[1].flatten(1) for cell in row], 1) for row in rows], 1)
    sky = torch.isinf(depth).to(signal.dtype)  # (B, 2, 2, cells)
    count = sky.sum(-1)
    # A sky that ends within a cell may show one of its phases only: then the other colours are not known.
    return (signal * sky).sum(-1) / count.clamp_min(1), (count > 0).flatten(1).all(1)


def _brightest(state: CameraState) -> Tensor:
    """Mean of the brightest 3 x 3 neighbourhood of each phase of the CFA, ``(B, 2, 2)``."""
    planes = torch.cat([state.signal[:, :, y::2, x::2] for y in (0, 1) for x in (0, 1)], 1)
    smooth = torch.nn.functional.avg_pool2d(planes, 3, stride=1, padding=1, count_include_pad=False)
    return smooth.amax((-2, -1)).view(-1, 2, 2)


def estimate_airlight(state: CameraState, owner: object) -> Tensor:
    """Signal of the horizon sky per colour, ``(B, 3)``: the mean over pixels of infinite depth.

    Where a frame shows no sky, the brightest 3 x 3 neighbourhood of each colour stands in, with a warning.
    """
    cells, seen = _sky_mean(state, SKY_STRIDE)  # (B, 2, 2)
    if is_exporting() or not bool(seen.all()):
        every, seen_at_all = _sky_mean(state, 1)  # a sky that shows between the thinned cells only
        cells, seen = torch.where(seen[:, None, None], cells, every), seen | seen_at_all
        cells = torch.where(seen[:, None, None], cells, _brightest(state))
    airlight = per_colour(cells, state.cfa_index)
    if not is_exporting() and state.signal.numel():
        if not bool(seen.all()):
            warnings.warn(
                f"{type(owner).__name__}: no sky (infinite depth) in the frame and no airlight given; the brightest "
                "spot stands in for it. Give airlight=(red, green, blue) in units of saturation.",
                TorchweatherWarning,
                stacklevel=3,
            )
        if bool((airlight.amax(1) < NIGHT_BELOW).any()):
            warnings.warn(
                f"{type(owner).__name__}: the sky is darker than {NIGHT_BELOW:g} of saturation; night and artificial "
                "light are not modelled. Give airlight= if this is day.",
                TorchweatherWarning,
                stacklevel=3,
            )
    return airlight


def per_colour(cells: Tensor, cfa_index: Tensor) -> Tensor:
    """Mean over the cells of each colour, ``(B, 2, 2)`` to ``(B, 3)``."""
    return torch.stack(
        [(cells * (cfa_index == colour)).sum((1, 2)) / (cfa_index == colour).sum().clamp_min(1) for colour in range(3)],
        1,
    )


def frame_mean(state: CameraState) -> Tensor:
    """Mean signal of each colour over the frame, ``(B, 3)``."""
    signal = by_cells(state.signal)  # (B, 1, H/2, 2, W)
    even, odd = signal[..., 0::2].mean((1, 2, 4)), signal[..., 1::2].mean((1, 2, 4))  # (B, 2)
    return per_colour(torch.stack([even, odd], -1), state.cfa_index)


@lru_cache(maxsize=32)
def _fog_table(
    size_distribution: str,
    wavelengths_nm: tuple[float, ...],
    temperature_c: float,
    model: str,
    contrast: float,
    variant: str | None,
) -> KnobTable:
    fog = Fog(mor_m=math.inf, size_distribution=size_distribution, contrast=contrast, temperature_c=temperature_c)
    if variant == "d3_4":
        return _table13_table()

    def extinction(mor_m: Tensor) -> Tensor:
        if model == "koschmieder":
            return extinction_from_mor(mor_m, contrast)[..., None].expand(*mor_m.shape, len(wavelengths_nm))
        distribution = fog.distribution(mor_m)
        bands = [extinction_per_m(distribution, w, temperature_c=temperature_c) for w in wavelengths_nm]
        return torch.stack(bands, -1)

    low, high = REHEARSE_RANGE_M if size_distribution == REHEARSE else (MOR_LOW_M, MOR_HIGH_M)
    return KnobTable(extinction, low, high, MOR_NODES, zero_at_inf=True)


def _table13_table() -> KnobTable:
    """Extinction of D3.4's Table 13 as published, log-log interpolated between its visibilities."""
    rows = {(row.visibility_m, row.colour): row.as_published for row in table13()}
    visibilities = sorted({visibility for visibility, _ in rows})
    log_v = torch.tensor([math.log(v) for v in visibilities], dtype=torch.float64)
    values = torch.tensor(
        [[math.log(rows[v, colour]) for colour in ("red", "green", "blue")] for v in visibilities], dtype=torch.float64
    )

    def extinction(mor_m: Tensor) -> Tensor:
        x = mor_m.double().log()
        cell = (x[..., None] >= log_v[1:-1]).sum(-1)
        share = ((x - log_v[cell]) / (log_v[cell + 1] - log_v[cell]))[..., None]
        return torch.exp(values[cell] * (1 - share) + values[cell + 1] * share)

    return KnobTable(extinction, visibilities[0], visibilities[-1], MOR_NODES, zero_at_inf=True)


def _warn_outside_table13(fog: Fog) -> None:
    mor_m = torch.as_tensor(fog.mor_m).detach().reshape(-1)
    outside = mor_m[mor_m.isfinite() & ((mor_m < 10) | (mor_m > 50))]
    if outside.numel():
        warnings.warn(
            f"ExtinctionAndAirlight: mor_m = {outside[0].item():g} m lies outside 10..50 m, the fogs of D3.4 Table 13; "
            'variant="d3_4" continues them as a power law.',
            TorchweatherWarning,
            stacklevel=4,
        )


@register
class ExtinctionAndAirlight(Stage):
    """Fog: the scene fades along the ray and the airlight takes its place.

    ``I = I0 exp(-alpha l) + A (1 - exp(-alpha l))`` per CFA colour, l the length of the ray, not the depth
    (``PHYSICS.md`` 4.8).

    Identity: ``mor_m = inf``.

    Args:
        weather: the fog, or its dictionary.
        wavelengths_nm: of the CFA's red, green (or clear) and blue.
        airlight: linear signal of an infinitely deep fog per colour, saturation 1; ``None`` takes the frame's sky.
        extinction: ``mie`` (Mie theory over the fog's own distribution) or ``koschmieder`` (ln(1/contrast)/MOR).
        variant: ``d3_4`` takes the extinction of the deliverable's Table 13 as published.
    """

    default_name: ClassVar[str] = "extinction_and_airlight"

    def __init__(
        self,
        weather: Fog | Mapping[str, Any],
        wavelengths_nm: Sequence[float],
        airlight: Sequence[float] | float | None = None,
        extinction: str = "mie",
        variant: str | None = None,
    ) -> None:
        super().__init__()
        fog = weather if isinstance(weather, Fog) else weather_from_dict(weather)
        if not isinstance(fog, Fog):
            raise TypeError(f"ExtinctionAndAirlight: weather must be Fog; got {type(fog).__name__}.")
        check_one_of("extinction", extinction, EXTINCTION_MODELS, owner=self)
        if variant == "d3_4":
            _warn_outside_table13(fog)
        self.weather = fog
        self.wavelengths_nm = tuple(float(w) for w in wavelengths_nm)
        self.extinction_model, self.variant = extinction, variant
        self.given_airlight = three_colours(airlight)
        # A copy: .to(dtype) or load_state_dict of one stage must not reach the cached table of all others.
        self.table = copy.deepcopy(
            _fog_table(fog.size_distribution, self.wavelengths_nm, fog.temperature_c, extinction, fog.contrast, variant)
        )
        self.register_buffer("mor_m", torch.as_tensor(fog.mor_m, dtype=torch.float32))
        self.mor_m: Tensor

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "weather": self.weather.to_dict(),
            "wavelengths_nm": list(self.wavelengths_nm),
            "airlight": None if self.given_airlight is None else list(self.given_airlight),
            "extinction": self.extinction_model,
            "variant": self.variant,
        }

    def extinction_per_m(self, batch: int) -> Tensor:
        """Extinction per colour along the ray, 1/m, ``(B, 3)``."""
        per_band: Tensor = self.table.to(self.mor_m.device)(self.mor_m.reshape(-1))
        return per_band.expand(batch, 3)

    def airlight(self, state: CameraState) -> Tensor:
        """Airlight per colour, ``(B, 3)``: given, or the frame's sky."""
        if self.given_airlight is None:
            return estimate_airlight(state, self)
        return torch.tensor(self.given_airlight, device=state.signal.device, dtype=state.signal.dtype).expand(
            state.batch, 3
        )

    def forward(self, state: CameraState, noise: Mapping[str, Tensor], out: Tensor | None = None) -> CameraState:
        """The foggy frame."""
        extinction = self.extinction_per_m(state.batch).to(state.signal.dtype)
        airlight = scaled_airlight(self.airlight(state), state)
        if state.extinction_scale is not None:
            extinction = extinction * state.extinction_scale
        density = state.fog_density
        if state.patches is not None and self.weather.patch_log_std != 0.0:
            banks = state.patches.banks(self.weather)
            azimuth_rad, level = ground_rays(state)
            patchy = banks.mean_to(azimuth_rad, level * state.depth_m.clamp_max(FARTHEST_M)).to(state.signal.dtype)
            density = patchy if density is None else density * patchy
            state = replace(state, fog_density=density)
        alpha_rows, light_rows = state.per_pixel(-extinction), state.per_pixel(airlight)

        # Zero extinction times infinite depth is zero, and so is its gradient.
        clip = is_exporting() or extinction.requires_grad or density is not None or bool((extinction == 0).any())

        def band(first: int, last: int, into: Tensor | None) -> tuple[Tensor, ...]:
            rows = (..., slice(first, last), slice(None))
            depth_m = state.depth_m[rows].clamp_max(FARTHEST_M) if clip else state.depth_m[rows]
            ray_m = depth_m * state.ray_per_depth[rows]
            clear = by_cells(ray_m if density is None else ray_m * density[rows]) * alpha_rows
            clear = clear.clamp_min_(-OPAQUE).exp_()
            # lerp gives either end exactly: the scene where clear is 1, the airlight where it is 0.
            ends = light_rows.expand_as(clear), by_cells(state.signal[rows])
            if into is not None and not clear.requires_grad:
                torch.lerp(*ends, clear, out=by_cells(into))
                seen = into
            else:
                seen = torch.lerp(*ends, clear).flatten(2, 3)
            if not state.keep_truth:
                return (seen,)
            return seen, torch.nn.functional.threshold(clear, OPAQUE_TRANSMISSION, 0.0).flatten(2, 3)

        results = by_rows(band, state.signal.shape, state.signal, out)
        transmission = results[1] if state.keep_truth else None
        return replace(
            state, signal=results[0], airlight=airlight, fog_extinction_per_m=extinction, transmission=transmission
        )


def rays(state: CameraState) -> tuple[Tensor, Tensor]:
    """x and y of every pixel's ray, scaled to z = 1, in the camera's frame, ``(1 or B, 1, H, W)`` each."""
    assert state.camera is not None
    height, width = state.signal.shape[-2:]
    fx, fy, cx, cy = (value.view(-1, 1, 1, 1) for value in state.intrinsics.to(state.signal).unbind(-1))
    column = torch.arange(width, device=fx.device).to(fx.dtype)
    row = torch.arange(height, device=fx.device).to(fx.dtype)[:, None]
    x, y = ((column - cx) / fx).expand(-1, 1, height, width), ((row - cy) / fy).expand(-1, 1, height, width)
    return state.camera.undistort(x, y)


def ground_rays(state: CameraState) -> tuple[Tensor, Tensor]:
    """Azimuth of every pixel's ray, and metres over ground per metre of depth, ``(1 or B, 1, H, W)`` each."""
    assert state.camera is not None
    return over_ground(state.camera, *rays(state))


def over_ground(camera: Camera, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Azimuth (from forward to left), and metres over ground per metre of depth, of rays (x, y, 1)."""
    # The columns of the rotation are the vehicle's axes in the camera's frame.
    (fx, lx, _), (fy, ly, _), (fz, lz, _) = camera.camera_from_vehicle()
    forward, left = fx * x + fy * y + fz, lx * x + ly * y + lz
    return torch.atan2(left, forward), (forward.square() + left.square()).sqrt()


def scaled_airlight(airlight: Tensor, state: CameraState) -> Tensor:
    """Airlight ``(B, 3)`` in the light that the state says, up to saturation."""
    return airlight if state.airlight_scale is None else (airlight * state.airlight_scale).clamp_max(1.0)


def three_colours(
    value: Sequence[float] | float | None, owner: object = "ExtinctionAndAirlight"
) -> tuple[float, float, float] | None:
    """One signal for all colours, or (red, green, blue), as three numbers in 0..1; ``None`` stays."""
    if value is None:
        return None
    values = (float(value),) * 3 if isinstance(value, (int, float)) else tuple(float(v) for v in value)
    if len(values) != 3 or not all(0.0 <= v <= 1.0 for v in values):
        raise ValueError(
            f"{owner_name(owner)}: airlight must be one number or (red, green, blue) in 0..1, linear, in units of "
            f"saturation; got {value!r}."
        )
    return values


@register
class Quantise(Stage):
    """The converter: clip to [0, 1] and round to a step.

    Identity: ``levels = 0``.

    Args:
        levels: number of steps from black to saturation, 4095 for 12 bits; 0 does nothing.
    """

    default_name: ClassVar[str] = "quantise"

    def __init__(self, levels: int = 0) -> None:
        super().__init__()
        self.register_buffer("levels", torch.tensor(float(levels)))
        self.levels: Tensor

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {"levels": int(self.levels)}

    def forward(self, state: CameraState, noise: Mapping[str, Tensor]) -> CameraState:
        """The rounded frame."""
        if not is_exporting() and float(self.levels) == 0:
            return state
        steps = self.levels.clamp_min(1)
        rounded = torch.round(state.signal.clamp(0, 1) * steps) / steps
        return replace(state, signal=torch.where(self.levels > 0, rounded, state.signal))
