"""Effects of the air and of wet surfaces in front of a camera.

Fog of extinction alpha lets ``T = exp(-alpha l)`` of a surface's light through on a ray of length l, and the airlight
A fills the rest, ``I = I0 T + A (1 - T)`` (``PHYSICS.md`` 4.8). The effects change alpha, A or what is between, by
fields of the state that ``ExtinctionAndAirlight`` reads. In weather without fog those of fog do nothing. Bounds and
typical sizes are orders of magnitude where no source is named.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from torchweather.camera.effects.mirrored import seen_along
from torchweather.camera.effects.particles import per_sample
from torchweather.camera.fog import FADING_COLOUR, FARTHEST_M, OPAQUE, rays
from torchweather.camera.mosaic_blur import gaussian_blur, phases, spacing_px, whole
from torchweather.camera.state import CameraState
from torchweather.camera.surfaces import ROAD_UP, ROAD_UP_RAMP
from torchweather.core.random import Variate
from torchweather.lidar.effects.air import transmittance_into_water
from torchweather.pipeline.effect import Effect, Parameter
from torchweather.pipeline.tiling import is_exporting

__all__ = [
    "CameraAerosolGlow",
    "CameraAirlightScale",
    "CameraExtinctionScale",
    "CameraHeightFog",
    "CameraPatchyFog",
    "CameraWetSurface",
]

VISIBLE_NM = 550.0  # at which visibility is defined
BANK_EDGES_M = (0.0, 20.0, 40.0, 80.0, 160.0, 320.0)  # depths between which a bank of fog lies, octaves
BANK_ROWS, BANK_COLUMNS = 4, 6  # banks over the picture in each depth: about as wide as deep; order of magnitude
GLOW_WIDTHS_PX = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
SMALL = 1e-3  # below which a quotient is its series


def ray_m(state: CameraState) -> Tensor:
    """Length of each pixel's ray inside the fog, finite, ``(1 or B, 1, H, W)``."""
    return state.fog_path_m(state.scene.depth_m.clamp_max(FARTHEST_M))


class CameraAirlightScale(Effect):
    """The light of the sky is another than modelled: fog and flakes are brighter, or of another colour.

    ``A`` becomes ``s A`` per colour, not above saturation: the picture gains ``(s - 1) A (1 - T)``, most where the
    scene is far. Flakes, and the sky in drops, follow.

    Args:
        red, green, blue: s, 0 to 5; green is the clear pixel's where there is one.
    """

    id: ClassVar[str] = "camera.airlight_scale"
    title: ClassVar[str] = "the airlight is brighter or darker"
    term: ClassVar[str] = "airlight (atmospheric light)"
    # The sky in the frame stands for the light from all sides; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(colour, "1", 0.0, 5.0, scale=0.2, identity=1.0) for colour in ("red", "green", "blue")
    )
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("depth_m", "colour")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.exposure_gain": "surfaces at several depths: a gain acts on near ones as well, airlight on far ones",
        "camera.stray_light": "near surfaces: airlight needs depth, stray light none",
    }
    reads: ClassVar[tuple[str, ...]] = ("air.airlight_scale", "image.signal")
    writes: ClassVar[tuple[str, ...]] = ("air.airlight_scale",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Light of the sky over the modelled one."""
        scale = torch.stack([per_sample(self, colour, state) for colour in ("red", "green", "blue")], -1)
        return {"airlight_scale": scale if state.air.airlight_scale is None else scale * state.air.airlight_scale}


class CameraExtinctionScale(Effect):
    """The extinction of the fog is another than modelled: ``alpha f (lambda / 550 nm)^-e``.

    The logarithm of the contrast falls along a line in depth; f is its slope over the modelled one, and e turns the
    colours' slopes apart.

    Args:
        factor: f, 0 to 10.
        wavelength_exponent: e, -4 to 4: Angstrom's exponent on top of the fog's own; 4 is Rayleigh's.
    """

    id: ClassVar[str] = "camera.extinction_scale"
    title: ClassVar[str] = "the air takes more or less light than modelled"
    term: ClassVar[str] = "extinction coefficient, Angstrom exponent"
    # Angstrom 1929: about 1.3 for haze, about 0 for droplets larger than the wavelength.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("factor", "1", 0.0, 10.0, scale=0.5, identity=1.0),
        Parameter("wavelength_exponent", "1", -4.0, 4.0, scale=0.5, identity=0.0),
    )
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("depth_m", "colour")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.height_fog": "rays that rise and rays that fall at one depth",
        "camera.patchy_fog": "frames and directions at one depth: patches differ, a factor does not",
    }
    needs: ClassVar[tuple[str, ...]] = ("camera",)
    reads: ClassVar[tuple[str, ...]] = ("air.extinction_scale", "image.signal", "receiver.camera")
    writes: ClassVar[tuple[str, ...]] = ("air.extinction_scale",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Extinction over the modelled one, per colour."""
        assert state.receiver.camera is not None
        factor, exponent = (per_sample(self, name, state)[:, None] for name in ("factor", "wavelength_exponent"))
        relative = [wavelength_nm / VISIBLE_NM for wavelength_nm in state.receiver.camera.bands.values()]
        scale = factor * torch.exp(-exponent * torch.log(state.image.signal.new_tensor(relative)))
        return {"extinction_scale": scale if state.air.extinction_scale is None else scale * state.air.extinction_scale}


class CameraPatchyFog(Effect):
    """Fog comes in banks: its density differs from place to place and from frame to frame, log-normally with mean 1.

    Each octave of distance up to 320 m holds banks about as wide as it is deep, ``rho = exp(s n - s^2 / 2)`` with n a
    standard normal field, smooth over the picture. A pixel's optical depth is the sum over its way,
    ``alpha sum(rho_k l_k)``, so that long ways average over several banks.

    Args:
        log_std: s, 0 to 2.

    Note:
        Particles in fog fade with its mean density.
    """

    id: ClassVar[str] = "camera.patchy_fog"
    title: ClassVar[str] = "fog comes in banks"
    term: ClassVar[str] = "heterogeneous fog"
    # Liquid water in radiation fog scatters by some ten percent within minutes; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (Parameter("log_std", "1", 0.0, 2.0, scale=0.3, identity=0.0),)
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("frame", "place")
    scatters: ClassVar[bool] = True
    of_the_air: ClassVar[bool] = True
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.height_fog": "frames: height layers stay, banks move",
        "camera.extinction_scale": "frames and directions at one depth: patches differ, a factor does not",
    }
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.ray_in_layer_m", "scene.ray_per_depth"),
        "air.fog_density",
        "image.signal",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.fog_density",)

    def variates(self) -> tuple[Variate, ...]:
        """A number a bank."""
        return (Variate("density", "normal", (len(BANK_EDGES_M) - 1, BANK_ROWS, BANK_COLUMNS)),)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Mean density along each ray."""
        drawn = noise["density"].to(state.image.signal)
        height, width = state.image.signal.shape[-2:]
        down, across = _between(height, BANK_ROWS, drawn), _between(width, BANK_COLUMNS, drawn)
        length_m = ray_m(state).expand_as(state.one_plane)
        log_std = self.value("log_std", state.image.signal)
        more_m = torch.zeros_like(length_m)
        for layer, (near_m, far_m) in enumerate(itertools.pairwise(BANK_EDGES_M)):
            normal = (down @ drawn[:, layer] @ across.T)[:, None]
            # Less 1, so that without patches nothing is added.
            excess = torch.expm1(log_std * normal - 0.5 * log_std.square())
            more_m = more_m + excess * (length_m - near_m).clamp(0.0, far_m - near_m)
        density = 1.0 + more_m / length_m.clamp_min(1e-6)
        return {"fog_density": density if state.air.fog_density is None else density * state.air.fog_density}


def _between(pixels: int, nodes: int, like: Tensor) -> Tensor:
    """Weights ``(pixels, nodes)`` of nodes spread over an axis; squares sum to 1, which keeps a normal's variance."""
    place = (torch.arange(pixels, device=like.device).to(like.dtype) + 0.5) * ((nodes - 1) / pixels)
    distance = (place[:, None] - torch.arange(nodes, device=like.device).to(like.dtype)).abs().clamp_max(1.0)
    # Squares of a cosine and of a sine sum to 1.
    return torch.cos(0.5 * math.pi * distance) * (distance < 1.0)


class CameraHeightFog(Effect):
    """Fog thins out with height: ``alpha exp(-(h - h0) / H)``, with the weather's visibility at the camera, h0.

    Along a ray that rises by ``x H`` the mean density is ``(1 - exp(-x)) / x``: the fog overhead ends, and the ground
    below the camera is in denser fog.

    Args:
        scale_height_m: H, 1 m to infinity.

    Note:
        Particles in fog fade with the density at the camera.
    """

    id: ClassVar[str] = "camera.height_fog"
    title: ClassVar[str] = "fog thins out with height"
    term: ClassVar[str] = "ground fog, exponential height fog"
    # Ground fog is a few metres to some tens of metres deep; order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale_height_m", "m", 1.0, math.inf, scale=20.0, identity=math.inf),
    )
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("elevation_rad", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.patchy_fog": "frames: height layers stay, banks move",
        "camera.extinction_scale": "rays that rise and rays that fall at one depth",
    }
    needs: ClassVar[tuple[str, ...]] = ("camera",)
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.intrinsics"),
        "air.fog_density",
        "image.signal",
        "receiver.camera",
    )
    writes: ClassVar[tuple[str, ...]] = ("air.fog_density",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Mean density along each ray."""
        assert state.receiver.camera is not None
        x, y = rays(state)
        down = state.receiver.camera.down_direction()
        rise_m = -(x * down[0] + y * down[1] + down[2]) * state.scene.depth_m.clamp_max(FARTHEST_M)
        # Sixty scale heights down nothing is seen whatever the density.
        scaled = (rise_m / self.value("scale_height_m", state.image.signal)).clamp_min(-60.0)
        small = scaled.abs() < SMALL
        apart = torch.where(small, 1.0, scaled)
        density = torch.where(small, 1.0 - 0.5 * scaled, -torch.expm1(-apart) / apart)
        density = density.expand_as(state.one_plane)
        return {"fog_density": density if state.air.fog_density is None else density * state.air.fog_density}


class CameraAerosolGlow(Effect):
    """Light scattered forward several times softens what is seen through fog, the more the farther it is.

    With the optical depth tau in front of a pixel, ``1 - exp(-a tau)`` of its light comes from around it, from a
    Gaussian with a standard deviation of ``b tau`` (at most 32 px): in front of a far surface the fog scatters its
    neighbours' light into the ray.

    Args:
        share_per_optical_depth: a, 0 to 5.
        width_px_per_optical_depth: b, 0 to 32 px; 4 px unless told.
    """

    id: ClassVar[str] = "camera.aerosol_glow"
    title: ClassVar[str] = "fog softens what is far"
    term: ClassVar[str] = "multiple scattering, atmospheric point-spread function (glow)"
    # Narasimhan & Nayar 2003 for the form; droplets scatter half of the light within some degrees, order of magnitude.
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("share_per_optical_depth", "1", 0.0, 5.0, scale=0.3, identity=0.0),
        Parameter("width_px_per_optical_depth", "px", 0.0, 32.0, scale=4.0, default=4.0),
    )
    after: ClassVar[str] = "extinction_and_airlight"
    axes: ClassVar[tuple[str, ...]] = ("edge_width_px", "depth_m")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.defocus": "edges at several depths: a glow leaves near ones sharp"
    }
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.depth_m", "scene.ray_in_layer_m", "scene.ray_per_depth"),
        *("air.fog_density", "air.fog_extinction_per_m"),
        "image.signal",
        "receiver.cfa_index",
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The softened frame."""
        if state.air.fog_extinction_per_m is None:
            return {"signal": state.image.signal}
        extinction = state.air.fog_extinction_per_m[:, FADING_COLOUR]
        if not is_exporting() and not extinction.requires_grad and bool((extinction == extinction[:1]).all()):
            extinction = extinction[:1]  # frames in one fog are blurred alike
        depth = ray_m(state) * extinction.view(-1, 1, 1, 1)
        if state.air.fog_density is not None:
            depth = depth * state.air.fog_density
        depth = depth.clamp_max(OPAQUE)
        apart = spacing_px(state)
        share = phases(-torch.expm1(-self.value("share_per_optical_depth", depth) * depth), apart)
        width = self.value("width_px_per_optical_depth", depth) * depth
        variance = phases(width.clamp_max(GLOW_WIDTHS_PX[-1]).square(), apart)
        # Between the two blurs next to its own a pixel's variance is met by their mixture.
        level, glow = phases(state.image.signal, apart), torch.zeros_like(share)
        widest = GLOW_WIDTHS_PX[-1] if is_exporting() or not width.numel() else float(width.detach().max())
        for number, here in enumerate(GLOW_WIDTHS_PX):
            if number:
                below = GLOW_WIDTHS_PX[number - 1]
                level = gaussian_blur(level, here**2 - below**2, apart)
                mixed = (variance - below**2) / (here**2 - below**2)
            else:
                mixed = torch.ones_like(variance)
            if number + 1 < len(GLOW_WIDTHS_PX):
                above = GLOW_WIDTHS_PX[number + 1]
                mixed = torch.minimum(mixed, (above**2 - variance) / (above**2 - here**2))
            glow = glow + mixed.clamp_min(0.0) * level
            if here >= widest:
                break
        return {"signal": whole(torch.lerp(phases(state.image.signal, apart), glow, share), apart)}


class CameraWetSurface(Effect):
    """Wet roads and other upward surfaces are darker and mirror what is behind them.

    ``I (1 - darkening w) (1 - mirror w R) + mirror w R I'`` with w the upward part of the normal, 0 on what stands
    upright, R Fresnel's reflectance of water at the angle of incidence, and I' the picture in the mirrored direction.
    Where the state says how wet each surface is (``WetRoad`` in the weather), w is multiplied by that.

    Args:
        darkening: share of the light that a wet level surface loses, 0 to 1.
        mirror: share of the film that is smooth, 0 to 1.

    Note:
        I' is that of things far away, seen in clear air. Where the mirrored ray passes above the picture, a mean of the
        picture's upper part stands in, over a wider part the farther above.
    """

    id: ClassVar[str] = "camera.wet_surface"
    title: ClassVar[str] = "roads are wet"
    term: ClassVar[str] = "reflectance of wet surfaces"
    # Wet asphalt and soil reflect 0.4 to 0.8 of what they do dry (Lekner & Dorf 1988).
    arguments: ClassVar[tuple[Parameter, ...]] = (
        Parameter("darkening", "1", 0.0, 1.0, scale=0.3, identity=0.0),
        Parameter("mirror", "1", 0.0, 1.0, scale=0.5, identity=0.0),
    )
    after: ClassVar[str] = "scene"
    axes: ClassVar[tuple[str, ...]] = ("up", "incidence")
    confusable_with: ClassVar[Mapping[str, str]] = {
        "camera.exposure_gain": "surfaces that stand upright: they stay as they are",
        "camera.vignetting": "walls and the sky in the corners: they are no darker where the road is wet",
    }
    needs: ClassVar[tuple[str, ...]] = ("camera", "normal")
    reads: ClassVar[tuple[str, ...]] = (
        *("scene.damp", "scene.ground", "scene.intrinsics", "scene.normal", "scene.pool"),
        "air.lamp_excess",
        "image.signal",
        *("receiver.camera", "receiver.cfa_index"),
    )
    writes: ClassVar[tuple[str, ...]] = ("image.signal",)

    def changes(self, state: CameraState, noise: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The wet scene."""
        assert state.receiver.camera is not None
        assert state.scene.normal is not None
        x, y = rays(state)
        upright = state.scene.normal.to(state.image.signal)
        turn = upright.new_tensor(state.receiver.camera.camera_from_vehicle())
        normal = torch.einsum("ij,bjhw->bihw", turn, _of_water(upright, state.scene.ground))  # in the camera's frame
        direction = torch.cat([x, y, torch.ones_like(x)], 1)
        direction = direction / torch.linalg.vector_norm(direction, dim=1, keepdim=True)
        cosine = -(direction * normal).sum(1, keepdim=True)
        wet = upright[:, 2:].clamp_min(0.0)
        smooth = wet if state.scene.pool is None else wet * state.scene.pool
        wet = wet if state.scene.damp is None else wet * state.scene.damp
        share = self.value("mirror", state.image.signal) * smooth * (1.0 - transmittance_into_water(cosine))
        own = state.image.signal * (1.0 - self.value("darkening", state.image.signal) * wet)
        # A lamp's mirror image is as bright as the lamp.
        mirrored = seen_along(state, direction + 2.0 * cosine * normal, state.air.lamp_excess)
        return {"signal": torch.lerp(own, mirrored, share)}


def _of_water(normal: Tensor, ground: Tensor | None) -> Tensor:
    """Normals ``(B, 3, H, W)`` of what water lies on: on a guessed ground the mean of its level pixels for all.

    At the edges of guessed objects normals point anywhere, and single pixels would mirror a lamp.
    """
    if ground is None:
        return normal
    level = ground.to(normal) * (normal[:, 2:] > ROAD_UP + ROAD_UP_RAMP)
    mean = (level * normal).sum((2, 3), keepdim=True)
    length = torch.linalg.vector_norm(mean, dim=1, keepdim=True)
    return torch.where(length > 0.0, mean / length.clamp_min(1e-12), normal)
