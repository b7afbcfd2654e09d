"""Camera stages of a continuous medium and of the output: extinction with airlight, quantisation."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchweather.atmosphere.weather import REHEARSE, REHEARSE_MOR_M, Fog, weather_from_dict
from torchweather.camera.airlight import airlight_argument, given_or_estimated, own_air, scaled_airlight
from torchweather.camera.compiled_rows import NOTHING, bands_of, colour_rows, map_of, on_processor
from torchweather.camera.multiple_scattering import forward_scattered, kernel_weights
from torchweather.camera.sensor import Camera
from torchweather.camera.state import CameraState
from torchweather.core.arguments import check_arguments
from torchweather.core.compiled import uses_compiled
from torchweather.core.errors import InputTypeError, InputValueError, TorchweatherWarning, check_one_of
from torchweather.core.masks import compare
from torchweather.core.threads import side_by_side
from torchweather.physics import InterpolationTable, extinction_from_mor, extinction_per_m
from torchweather.physics.d34 import table13
from torchweather.pipeline.registry import register
from torchweather.pipeline.stage import Stage
from torchweather.pipeline.tiling import by_rows, is_exporting

__all__ = ["ExtinctionAndAirlight", "Quantise"]

MOR_LOW_M, MOR_HIGH_M, MOR_NODES = 5.0, 20000.0, 96
REHEARSE_RANGE_M = (float(REHEARSE_MOR_M[0]), float(REHEARSE_MOR_M[-1]))
OPAQUE = 80.0  # optical depth that leaves nothing to see; beyond it float32 turns subnormal and slow
OPAQUE_TRANSMISSION = 2.0 * math.exp(-OPAQUE)  # reported as 0
FARTHEST_M = 1e12  # stands for an infinite depth, so that zero extinction times it is zero
FADING_COLOUR = 1  # where one colour stands for all: green, or clear
EXTINCTION_MODELS = ("mie", "koschmieder")
SCATTERING_MODELS = ("single", "multiple")


@lru_cache(maxsize=32)
def _fog_table(
    size_distribution: str,
    wavelengths_nm: tuple[float, ...],
    temperature_c: float,
    model: str,
    contrast: float,
    variant: str | None,
) -> InterpolationTable:
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
    return InterpolationTable(extinction, low, high, MOR_NODES, zero_at_inf=True)


def _table13_table() -> InterpolationTable:
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

    return InterpolationTable(extinction, visibilities[0], visibilities[-1], MOR_NODES, zero_at_inf=True)


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

    ``I = I0 exp(-alpha l) + A (1 - exp(-alpha l))`` per colour, l the length of the ray, not the depth (``PHYSICS.md``
    4.8), up to the top of the layer where the ray leaves it: the sky shows through thin fog (``PHYSICS.md`` 10.11).
    Where a photograph's airlight is estimated, fog thinner than its own air leaves its sky as it is.

    Identity: ``mor_m = inf``.

    Args:
        weather: the fog, or its dictionary.
        wavelengths_nm: of the CFA's red, green (or clear) and blue.
        airlight: linear signal of an infinitely deep fog per colour, saturation 1; ``sky`` or ``grey`` takes colour or
            luminance of the sky above the horizon; ``None`` is grey for colour planes and sky for a mosaic.
        extinction: ``mie`` (Mie theory over the fog's own distribution) or ``koschmieder`` (ln(1/contrast)/MOR).
        variant: ``d3_4`` takes the extinction of the deliverable's Table 13 as published.
        scattering: ``single``, or ``multiple``: light that the fog scatters onward arrives as well, blurred
            (``multiple_scattering.py``), by Mie theory over the fog's own droplets.
    """

    default_name: ClassVar[str] = "extinction_and_airlight"
    reads: ClassVar[tuple[str, ...]] = (
        "scene.depth_m",
        "scene.intrinsics",
        "scene.near_mask",
        "scene.ray_in_layer_m",
        "scene.ray_per_depth",
        "scene.sine_elevation",
        "scene.sky",
        *("air.airlight_scale", "air.extinction_scale", "air.fog_density", "air.lamp_excess", "air.lamp_light"),
        "air.patches",
        "image.signal",
        *("receiver.camera", "receiver.cfa_index", "receiver.keep_truth"),
    )
    writes: ClassVar[tuple[str, ...]] = (
        *("air.airlight", "air.fog_density", "air.fog_extinction_per_m"),
        *("image.signal", "image.transmission"),
    )

    def __init__(
        self,
        weather: Fog | Mapping[str, Any],
        wavelengths_nm: Sequence[float],
        airlight: Sequence[float] | float | str | Mapping[str, float] | None = None,
        extinction: str = "mie",
        variant: str | None = None,
        scattering: str = "single",
    ) -> None:
        check_arguments(
            "ExtinctionAndAirlight(weather: Fog | Mapping, wavelengths_nm: Sequence[float], "
            "airlight: Sequence[float] | float | str | Mapping | None, extinction: str, variant: str | None, "
            "scattering: str)",
            weather,
            wavelengths_nm,
            airlight,
            extinction,
            variant,
            scattering,
        )
        super().__init__()
        fog = weather if isinstance(weather, Fog) else weather_from_dict(weather)
        if not isinstance(fog, Fog):
            raise InputTypeError(f"ExtinctionAndAirlight: weather must be Fog; got {type(fog).__name__}.")
        check_one_of("extinction", extinction, EXTINCTION_MODELS, owner=self)
        check_one_of("scattering", scattering, SCATTERING_MODELS, owner=self)
        if variant == "d3_4":
            _warn_outside_table13(fog)
        self.weather = fog
        self.wavelengths_nm = tuple(float(w) for w in wavelengths_nm)
        if not self.wavelengths_nm:
            raise InputValueError("ExtinctionAndAirlight: wavelengths_nm must have one entry or more; got none.")
        self.extinction_model, self.variant, self.scattering = extinction, variant, scattering
        self.given_airlight = airlight_argument(airlight, self)
        # A copy: .to(dtype) or load_state_dict of one stage must not reach the cached table of all others.
        kept = _fog_table(
            fog.size_distribution, self.wavelengths_nm, fog.temperature_c, extinction, fog.contrast, variant
        )
        self.table = copy.copy(kept)  # a tenth of the time of a deep copy
        self.table._buffers = {name: None if one is None else one.clone() for name, one in kept._buffers.items()}
        self.register_buffer("mor_m", torch.as_tensor(fog.mor_m, dtype=torch.float32))
        self.mor_m: Tensor

    def config(self) -> dict[str, Any]:
        """Constructor arguments."""
        return {
            "weather": self.weather.to_dict(),
            "wavelengths_nm": list(self.wavelengths_nm),
            "airlight": list(self.given_airlight) if isinstance(self.given_airlight, tuple) else self.given_airlight,
            "extinction": self.extinction_model,
            "variant": self.variant,
            "scattering": self.scattering,
        }

    def extinction_per_m(self, batch: int) -> Tensor:
        """Extinction per colour along the ray, 1/m, ``(B, 3)``."""
        per_band: Tensor = self.table.to(self.mor_m.device)(self.mor_m.reshape(-1))
        return per_band.expand(batch, 3)

    def airlight(self, state: CameraState, extinction_per_m: Tensor | None = None) -> Tensor:
        """Airlight per colour, ``(B, 3)``: given, or estimated from the frame.

        Args:
            state: the frame.
            extinction_per_m: ``(B, 3)`` of the fog, where it is known.
        """
        if extinction_per_m is None and not isinstance(self.given_airlight, tuple):
            extinction_per_m = self.extinction_per_m(state.batch)
        return given_or_estimated(self.given_airlight, state, self, extinction_per_m)

    def forward(self, state: CameraState, noise: Mapping[str, Tensor], out: Tensor | None = None) -> CameraState:
        """The foggy frame."""
        own_extinction = self.extinction_per_m(state.batch)
        extinction = own_extinction.to(state.image.signal.dtype)
        airlight = scaled_airlight(self.airlight(state, own_extinction), state)
        if state.air.extinction_scale is not None:
            extinction = extinction * state.air.extinction_scale
        density = state.air.fog_density
        if state.air.patches is not None and self.weather.patch_log_std != 0.0:
            banks = state.air.patches.banks(self.weather)
            azimuth_rad, level = ground_rays(state)
            patchy = banks.mean_to(azimuth_rad, level * state.scene.depth_m.clamp_max(FARTHEST_M)).to(
                state.image.signal.dtype
            )
            density = patchy if density is None else density * patchy
            state = state.changed(fog_density=density)
        multiple, lamps = self.scattering == "multiple", state.air.lamp_excess is not None
        if multiple and is_exporting():
            raise InputValueError(
                "ExtinctionAndAirlight: scattering='multiple' cannot be exported; its pyramid depends on the size and "
                "the depths of the frame. Export with scattering='single'."
            )
        if self._is_compiled(state, extinction, airlight, out):
            seen, through = self._compiled(state, extinction, airlight, out)
            return state.changed(signal=seen, airlight=airlight, fog_extinction_per_m=extinction, transmission=through)
        alpha_rows, light_rows = state.per_pixel(-extinction), state.per_pixel(airlight)

        # Zero extinction times infinite depth is zero, and so is its gradient.
        clip = is_exporting() or extinction.requires_grad or density is not None or bool((extinction == 0).any())

        own = state.per_pixel(own_air(extinction)) if self._is_estimated(state) else None

        def let_through(ray_m: Tensor, rows: tuple[Any, ...]) -> Tensor:
            clear = state.by_cells(ray_m if density is None else ray_m * density[rows]) * alpha_rows
            return clear.clamp_min_(-OPAQUE).exp_()

        def band(first: int, last: int, into: Tensor | None) -> tuple[Tensor, ...]:
            rows = (..., slice(first, last), slice(None))
            depth_m = state.scene.depth_m[rows].clamp_max(FARTHEST_M) if clip else state.scene.depth_m[rows]
            clear = let_through(state.fog_path_m(depth_m, slice(first, last)), rows)
            if state.scene.sky is not None and state.scene.ray_in_layer_m is not None:
                # The share of the pixel that is sky is seen through all of the layer (PHYSICS.md 10.11).
                above = let_through(state.scene.ray_in_layer_m[rows], rows)
                clear = torch.lerp(clear, above, state.by_cells(state.scene.sky[rows]).to(clear.dtype))
            if own is not None:
                # Air as thin as the picture's own adds the light that each pixel of its sky has already.
                endless = compare(state.scene.depth_m[rows], ">=", torch.inf)
                sky = endless if state.scene.sky is None else state.scene.sky[rows]
                clear = 1.0 - (1.0 - clear) * (1.0 - state.by_cells(sky.to(clear.dtype)) * own)
            if state.scene.near_mask is not None:
                clear = torch.lerp(
                    clear, torch.ones_like(clear), state.by_cells(state.scene.near_mask[rows]).to(clear.dtype)
                )
            # lerp gives either end exactly: the scene where clear is 1, the airlight where it is 0.
            ends = light_rows.expand_as(clear), state.by_cells(state.image.signal[rows])
            if into is not None and not clear.requires_grad:
                torch.lerp(*ends, clear, out=state.by_cells(into))
                seen = into
            else:
                seen = torch.lerp(*ends, clear).flatten(2, 3)
            if not (state.receiver.keep_truth or multiple or lamps):
                return (seen,)
            return seen, torch.nn.functional.threshold(clear, OPAQUE_TRANSMISSION, 0.0).flatten(2, 3)

        results = by_rows(band, state.image.signal.shape, state.image.signal, out)
        if multiple or lamps:
            seen = self._with_forward_scattered(state, results, light_rows)
            results = (seen if out is None else out.copy_(seen), results[1])
        transmission = results[1] if state.receiver.keep_truth else None
        return state.changed(
            signal=results[0], airlight=airlight, fog_extinction_per_m=extinction, transmission=transmission
        )

    def _is_estimated(self, state: CameraState) -> bool:
        """True where the airlight of a picture is taken from its sky."""
        return state.receiver.cfa_index is None and not isinstance(self.given_airlight, tuple)

    def _is_compiled(self, state: CameraState, *values: Tensor | None) -> bool:
        """True where compiled loops compute the frame: on the processor, in single precision, without gradients."""
        if is_exporting() or not uses_compiled() or state.air.fog_density is not None:
            return False
        if self.scattering == "multiple" or state.air.lamp_excess is not None:
            return False
        return on_processor(state.image.signal, *_maps(state), *values)

    def _compiled(
        self, state: CameraState, extinction: Tensor, airlight: Tensor, out: Tensor | None
    ) -> tuple[Tensor, Tensor | None]:
        """The foggy frame by compiled loops, and the transmission where it is kept.

        Rows are independent, so that threads change no bit.
        """
        from torchweather.camera.compiled_fog import fog_rows

        signal = state.image.signal.detach().contiguous()
        seen = torch.empty_like(signal) if out is None else out
        through = torch.empty_like(signal) if state.receiver.keep_truth else None
        per_m, light = colour_rows(state, extinction), colour_rows(state, airlight)
        share = own_air(extinction).detach().numpy()
        own: NDArray[np.float32] = share if self._is_estimated(state) else np.zeros((state.batch, 0), np.float32)
        tasks = []
        for sample in range(state.batch):
            depth_m, ray, in_layer_m, sky, near = (map_of(one, sample) for one in _maps(state))
            kept = NOTHING[None] if through is None else through[sample].numpy()
            one = partial(
                fog_rows, seen[sample].numpy(), kept, signal[sample].numpy(), depth_m, ray, in_layer_m, sky, near
            )
            numbers = (per_m[sample], light[sample], np.ascontiguousarray(own[sample]), FARTHEST_M, OPAQUE)
            one = partial(one, *numbers, OPAQUE_TRANSMISSION)
            tasks += [partial(one, first, last) for first, last in bands_of(signal.shape[-2])]
        side_by_side(tasks)
        return seen, through

    def _with_forward_scattered(self, state: CameraState, results: tuple[Tensor, ...], light_rows: Tensor) -> Tensor:
        """The foggy frame with the light that the fog scatters onward, and lamps as bright as they are; bit for bit as
        it was where fog is infinitely thin.

        A lamp beyond saturation shows what the clear frame shows of it until the fog has dimmed it to that. Its light
        is scattered onward in any case: that is its glow.
        """
        weights = kernel_weights(
            self.weather, self.wavelengths_nm[FADING_COLOUR], self.mor_m.reshape(-1).expand(state.batch)
        )
        foggy, through = results[0], results[1]
        airlight = light_rows.expand_as(state.by_cells(state.image.signal)).flatten(2, 3)
        clear, excess = state.image.signal, state.air.lamp_excess
        source = clear if excess is None else clear + excess
        if self.scattering != "multiple" and excess is not None:  # by day light is scattered once
            source, airlight = excess, torch.zeros_like(airlight)
        added = forward_scattered(state.changed(signal=source), through, airlight, weights)
        if excess is not None:
            added = added + (torch.minimum(through * (clear + excess), clear) - through * clear).clamp_min(0.0)
        thick = torch.isfinite(self.mor_m.reshape(-1, 1, 1, 1))
        return torch.where(thick, foggy + added, foggy)


def _maps(state: CameraState) -> tuple[Tensor | None, ...]:
    """Maps of the scene that fog looks at, as ``fog_rows`` takes them."""
    scene = state.scene
    return scene.depth_m, scene.ray_per_depth, scene.ray_in_layer_m, scene.sky, scene.near_mask


def rays(state: CameraState) -> tuple[Tensor, Tensor]:
    """x and y of every pixel's ray, scaled to z = 1, in the camera's frame, ``(1 or B, 1, H, W)`` each."""
    assert state.receiver.camera is not None
    height, width = state.image.signal.shape[-2:]
    fx, fy, cx, cy = (value.view(-1, 1, 1, 1) for value in state.scene.intrinsics.to(state.image.signal).unbind(-1))
    column = torch.arange(width, device=fx.device).to(fx.dtype)
    row = torch.arange(height, device=fx.device).to(fx.dtype)[:, None]
    x, y = ((column - cx) / fx).expand(-1, 1, height, width), ((row - cy) / fy).expand(-1, 1, height, width)
    return state.receiver.camera.undistort(x, y)


def ground_rays(state: CameraState) -> tuple[Tensor, Tensor]:
    """Azimuth of every pixel's ray, and metres over ground per metre of depth, ``(1 or B, 1, H, W)`` each."""
    assert state.receiver.camera is not None
    return over_ground(state.receiver.camera, *rays(state))


def over_ground(camera: Camera, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Azimuth (from forward to left), and metres over ground per metre of depth, of rays (x, y, 1)."""
    # The columns of the rotation are the vehicle's axes in the camera's frame.
    (fx, lx, _), (fy, ly, _), (fz, lz, _) = camera.camera_from_vehicle()
    forward, left = fx * x + fy * y + fz, lx * x + ly * y + lz
    return torch.atan2(left, forward), (forward.square() + left.square()).sqrt()


@register
class Quantise(Stage):
    """The converter: clip to [0, 1] and round to a step.

    Identity: ``levels = 0``.

    Args:
        levels: number of steps from black to saturation, 4095 for 12 bits; 0 does nothing.
    """

    default_name: ClassVar[str] = "quantise"
    reads: ClassVar[tuple[str, ...]] = ("image.signal",)
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def __init__(self, levels: int = 0) -> None:
        check_arguments("Quantise(levels: int)", levels)
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
        rounded = torch.round(state.image.signal.clamp(0, 1) * steps) / steps
        return state.changed(signal=torch.where(self.levels > 0, rounded, state.image.signal))
