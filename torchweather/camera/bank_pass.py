"""BankPass: 8-bit RGB pictures behind the storms of a bank, by look-ups alone.

It computes what `BankVeil` does between decoding and encoding: the optical depth of each pixel from the bank, then
``(1 - M) I + M C`` in linear light. For one sample the result is a function of the optical depth and of the level of a
colour, so that decoding, blending and encoding are one table of each colour; no pixel is ever a float.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchweather.camera.depth import EXACT, SceneDepth, check_depth
from torchweather.camera.depth.source import warn_of_depth
from torchweather.camera.particles.bank import STORMS, DrawBank
from torchweather.camera.particles.bank_codes import BIN_SHIFT, BankTables
from torchweather.camera.particles.bank_veil import BankVeil
from torchweather.camera.rgb_planes import linear_planes
from torchweather.camera.state import CameraState
from torchweather.camera.tone import srgb_encode
from torchweather.camera.transform import BayerWeather
from torchweather.core.compiled import uses_compiled
from torchweather.core.random import draw_variates, sample_seeds
from torchweather.core.threads import one_thread_an_operation
from torchweather.pipeline.at_call import weather_at_call

__all__ = ["BankPass", "Scene", "in_training_weather"]

STAGE = "particle_veil"

# Classes of optical depth: the highest bits of ``tau + OFFSET``, 32 per octave. Half a class is 1.2e-4 where there is
# next to nothing and 1.6 % of what there is where there is much; 6 covers all but 0.2 % of a pixel.
OFFSET = 2.0**-7
CLASS_SHIFT = 18
MOST_OPTICAL_DEPTH = 6.0
BAND_PIXELS = 1 << 16
THINNED = 4  # rows and columns from one to the next of the pixels of which colours are taken
ROOTS = 1 << 14  # nodes of the root of linear light at which levels are tabulated: 0.02 levels apart at most


def _bits(value: float, shift: int) -> int:
    return int(torch.tensor(value, dtype=torch.float32).view(torch.int32)) >> shift


FIRST_CLASS = _bits(OFFSET, CLASS_SHIFT)
CLASSES = _bits(MOST_OPTICAL_DEPTH, CLASS_SHIFT) - FIRST_CLASS + 1


@lru_cache(maxsize=1)
def _look_ups() -> tuple[Tensor, Tensor, Tensor]:
    """Linear light of each level, the level at each root of linear light, and the covered share of each class."""
    levels = linear_planes(torch.arange(256, dtype=torch.uint8))
    roots = torch.linspace(0.0, 1.0, ROOTS)
    encoded = srgb_encode(roots.square()).mul_(255.0).round_().to(torch.uint8)
    edges = ((torch.arange(CLASSES + 1, dtype=torch.int32) + FIRST_CLASS) << CLASS_SHIFT).view(torch.float32)
    optical = 0.5 * (edges[1:] + edges[:-1]) - OFFSET
    optical[0] = 0.0  # the identity, bit for bit
    return levels, encoded, -torch.expm1(-optical)[:, None]


@dataclass(frozen=True)
class Scene:
    """Common parts of all pictures of one size, and the depth of one.

    Args:
        depth_m: ``(H, W)`` metres along the axis; infinity is sky.
        ray_per_depth: ``(H, W)`` length of each pixel's ray per depth.
        thinned: what the veil's colours are taken from, but the signal: fields of `CameraState.of`.
    """

    depth_m: Tensor
    ray_per_depth: Tensor
    thinned: dict[str, Any]


class BankPass:
    """Pictures of 8 bits behind the storms of a bank.

    Args:
        veil: of one kind of particles, whose colours and bank are taken.
    """

    def __init__(self, veil: BankVeil) -> None:
        self.veil = veil
        self.bank: DrawBank = veil.banks[0]
        self._levels, self._encoded, self._covered = _look_ups()

    def picture(self, rgb: Tensor, scene: Scene, rate_mm_per_h: float, place: Tensor) -> Tensor:
        """One picture in weather.

        Args:
            rgb: ``(3, H, W)`` uint8.
            scene: depth and rays.
            rate_mm_per_h: 0 gives the picture itself.
            place: ``(storms, 3)``, of `DrawBank.variate`.

        Returns:
            ``(3, H, W)`` uint8.
        """
        if rate_mm_per_h <= 0:
            self.bank.node_of(rate_mm_per_h)
            return rgb
        height, width = rgb.shape[-2:]
        tables = self.bank.at_rate(rate_mm_per_h)
        codes = self.bank.codes(tables.node)
        places = self.bank.places(place, height, width)
        blended = self._blended(self._colour(rgb, scene))
        result = torch.empty((3, height, width), dtype=torch.uint8)
        place_in = _compiled_rows if uses_compiled() else self._rows
        place_in(rgb, scene, tables, codes, places, blended, result)
        return result

    def _rows(
        self,
        rgb: Tensor,
        scene: Scene,
        tables: BankTables,
        codes: Tensor,
        places: Sequence[tuple[Tensor, Tensor]],
        blended: Tensor,
        result: Tensor,
    ) -> None:
        """Write the picture to ``result``, band by band."""
        height, width = result.shape[-2:]
        rows = max(1, BAND_PIXELS // width)
        for first in range(0, height, rows):
            band = slice(first, min(first + rows, height))
            classes = self._classes(scene.depth_m[band], scene.ray_per_depth[band], tables, codes, places, band)
            for colour in range(3):
                index = rgb[colour, band].reshape(-1).int().add_(classes)
                torch.index_select(blended[colour], 0, index, out=result[colour, band].view(-1))

    def _classes(
        self,
        depth_m: Tensor,
        ray: Tensor,
        tables: BankTables,
        codes: Tensor,
        places: Sequence[tuple[Tensor, Tensor]],
        band: slice,
    ) -> Tensor:
        """Class of each pixel's optical depth, times 256, ``(rows * W,)`` int32."""
        bins = depth_m.clamp(tables.near_m, tables.far_m).view(torch.int32)
        bins = bins.bitwise_right_shift_(BIN_SHIFT).sub_(tables.first_bin)
        base = tables.base.index_select(0, bins.view(-1)).view(bins.shape)
        total = None
        for storm, (down, across) in enumerate(places):
            where = (base + down[band, None]).add_(across)
            code = codes[storm].index_select(0, where.view(-1)).int()
            optical = tables.level.index_select(0, code)
            total = optical if total is None else total.add_(optical)
        assert total is not None
        bins = bins.view(-1)
        total.mul_(tables.amplitude.index_select(0, bins)).add_(tables.even.index_select(0, bins))
        total.mul_(ray.reshape(-1)).add_(OFFSET).clamp_max_(MOST_OPTICAL_DEPTH)
        return total.view(torch.int32).bitwise_right_shift_(CLASS_SHIFT).sub_(FIRST_CLASS).bitwise_left_shift_(8)

    def _colour(self, rgb: Tensor, scene: Scene) -> Tensor:
        """Colour of the particles, ``(3,)``, from the thinned picture."""
        some = rgb[:, ::THINNED, ::THINNED].contiguous()
        signal = self._levels.index_select(0, some.view(-1).int()).view(1, *some.shape)
        return self.veil.colours(CameraState.of(signal=signal, **scene.thinned))[0][0]

    def _blended(self, colour: Tensor) -> Tensor:
        """Level of each colour behind particles, ``(3, classes * 256)`` uint8: decoded, blended and encoded."""
        root = torch.lerp(self._levels, colour.float().view(3, 1, 1), self._covered).sqrt_()
        index = root.mul_(ROOTS - 1).add_(0.5).int()
        levels = self._encoded.index_select(0, index.view(-1)).view(3, CLASSES, 256)
        levels[:, 0] = torch.arange(256, dtype=torch.uint8)
        return levels.view(3, -1)


def _compiled_rows(
    rgb: Tensor,
    scene: Scene,
    tables: BankTables,
    codes: Tensor,
    places: Sequence[tuple[Tensor, Tensor]],
    blended: Tensor,
    result: Tensor,
) -> None:
    """Write the picture to ``result``: the same by a compiled loop."""
    from torchweather.camera.compiled_bank_pass import picture_rows

    picture_rows(
        rgb.contiguous().numpy(),
        scene.depth_m.numpy(),
        scene.ray_per_depth.numpy(),
        tables.base.numpy(),
        tables.amplitude.numpy(),
        tables.even.numpy(),
        tables.level.numpy(),
        codes.numpy(),
        torch.stack([down for down, _ in places]).numpy(),
        torch.stack([across for _, across in places]).numpy(),
        blended.numpy(),
        np.float32(tables.near_m),
        np.float32(tables.far_m),
        np.float32(OFFSET),
        np.float32(MOST_OPTICAL_DEPTH),
        np.int32(tables.first_bin),
        np.int32(FIRST_CLASS),
        np.int32(BIN_SHIFT),
        np.int32(CLASS_SHIFT),
        result.numpy(),
    )


def in_training_weather(
    transform: BayerWeather,
    rgb: Tensor,
    depth: Tensor | SceneDepth | None,
    noise: Mapping[str, Tensor] | None,
    seed: int | Tensor | None,
    generator: torch.Generator | None,
    rates_mm_per_h: Sequence[float] | None = None,
    airlight: Any = None,
) -> Tensor | None:
    """Pictures in the weather of a transform of training quality; ``None`` where it takes more than look-ups.

    Args:
        transform: fitted to the pictures' size.
        rgb: ``(..., 3, H, W)``.
        depth, noise, seed, generator: as of `AsBayer.forward`.
        rates_mm_per_h: of each picture; ``None`` is the transform's own.
        airlight: likewise.
    """
    if transform.nuisances:
        return None
    veil = transform.chain.stages.get(STAGE)
    plain = isinstance(veil, BankVeil) and list(transform.chain.stages) == [STAGE, "quantise"]
    if not isinstance(veil, BankVeil) or not plain or len(veil.banks) != 1:
        return None
    if rgb.dtype != torch.uint8 or rgb.device.type != "cpu" or rgb.shape[-3] != 3 or not rgb.numel():
        return None
    scene = _scene_depth(transform, rgb, depth)
    if scene.near_mask is not None or scene.depth_m.requires_grad:
        return None
    batch = rgb.shape[:-3]
    number = math.prod(batch)
    rates = rates_mm_per_h
    if noise is None:
        seeds = sample_seeds((number,), generator, seed.reshape(-1) if isinstance(seed, Tensor) else seed)
        if transform.is_random:
            if set(transform.weather.random) - {"rate_mm_per_h"}:
                return None
            transform.refuse_changes()
            weather: Any = weather_at_call(transform.weather, transform.p, (number,), seeds, transform)
            rates = weather.rate_mm_per_h.tolist()
        drawn = draw_variates(seeds, STAGE, veil.variates(), {})
        noise = {name: torch.from_numpy(array) for name, array in drawn.items()}
    places = noise.get(f"{STAGE}.{veil.banks[0].variate().name}")
    if places is None or places.numel() != number * STORMS * 3:
        return None  # the general path says what is wrong
    if rates is None:
        rates = veil.parts[0].rate_mm_per_h.detach().float().reshape(-1).expand(number).tolist()
    state = transform.scene_state(torch.zeros(()).expand(number, 3, *rgb.shape[-2:]), scene, batch)
    quick = BankPass(veil if airlight is None else veil.in_airlight(airlight))
    pictures = rgb.reshape(number, 3, *rgb.shape[-2:])
    with torch.no_grad(), one_thread_an_operation():
        each = [
            quick.picture(pictures[row], _scene(state, row), rates[row], place)
            for row, place in enumerate(places.detach().reshape(number, STORMS, 3).float())
        ]
    if number == 1:  # clear air gives the picture itself
        return each[0].reshape(rgb.shape).clone() if rates[0] <= 0 else each[0].reshape(rgb.shape)
    return torch.stack(each).reshape(rgb.shape)


def _scene_depth(transform: BayerWeather, rgb: Tensor, depth: Tensor | SceneDepth | None) -> SceneDepth:
    """As `BayerWeather.scene_of`; what only leads to a warning is looked at in the thinned map."""
    if not isinstance(depth, Tensor):
        return transform.scene_of(rgb, depth)
    check_depth(depth, *rgb.shape[-2:], owner=transform)
    warn_of_depth(depth[..., ::THINNED, ::THINNED], transform.camera, transform)
    return SceneDepth(depth, EXACT)


def _scene(state: CameraState, row: int) -> Scene:
    """Inputs of the pass from one sample of a state."""

    def own(value: Tensor | None) -> Tensor | None:
        return None if value is None else value[row : row + 1] if len(value) > 1 else value

    every = (..., slice(None, None, THINNED), slice(None, None, THINNED))
    fields: dict[str, Any] = {"intrinsics": state.scene.intrinsics, "camera": state.receiver.camera, "cfa_index": None}
    for name in ("depth_m", "ray_per_depth", "sky", "sine_elevation"):
        value = own(getattr(state.scene, name))
        fields[name] = None if value is None else value[every]
    depth_m, sky, ray = own(state.scene.depth_m), own(state.scene.sky), own(state.scene.ray_per_depth)
    assert depth_m is not None
    assert ray is not None
    if sky is not None:
        depth_m = torch.where(sky > 0.5, torch.inf, depth_m)
    return Scene(depth_m[0, 0].contiguous(), ray[0, 0].contiguous(), fields)
