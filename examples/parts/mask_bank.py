"""A bank of particle masks: optical depths rendered beforehand at a few depths, from which frames take windows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Rain, Snow
from torchweather.io import atomic_write

NEAR_M = 0.5
SKY_SIGNAL = 1.0  # the masks do not depend on it


@dataclass(frozen=True)
class MaskBank:
    """Optical depth of the particles nearer than a few depths, on a frame with a margin.

    Args:
        optical_depth: ``(N, D, H + 2 margin, W + 2 margin)`` float16.
        depths_m: ``(D,)`` geometric from the nearest to the farthest particle.
        margin_px: how far a window can be moved.
        mirrored: whether entries may be turned upside down.
    """

    optical_depth: Tensor
    depths_m: Tensor
    margin_px: int
    mirrored: bool

    @classmethod
    def rendered(
        cls, weather: Rain | Snow, camera: tw.Camera, entries: int, depths: int, margin_px: int, far_m: float
    ) -> MaskBank:
        """Render every entry at every depth with the library."""
        cx, cy = camera.principal_point_px
        wide = replace(
            camera,
            width=camera.width + 2 * margin_px,
            height=camera.height + 2 * margin_px,
            cx=cx + margin_px,
            cy=cy + margin_px,
        )
        depths_m = torch.logspace(math.log10(NEAR_M), math.log10(far_m), depths)
        transform = tw.BayerWeather(weather, wide, airlight=SKY_SIGNAL, near_m=NEAR_M, far_m=far_m)
        black = torch.zeros(1, wide.height, wide.width)
        stored = torch.zeros(entries, depths, wide.height, wide.width, dtype=torch.float16)
        for entry in range(entries):
            noise = transform.draw(black, seed=entry)
            for number in range(1, depths):  # no particle is nearer than the first
                scene = torch.full_like(black, float(depths_m[number]))
                mask = transform.run(black, scene, noise).particle_mask[0]
                stored[entry, number] = -torch.log1p(-mask)
        still = weather.wind_m_per_s == (0.0, 0.0, 0.0) and camera.roll_rad == 0 and camera.pitch_rad == 0
        return cls(stored, depths_m, margin_px, still)

    def save(self, path: Path) -> None:
        with atomic_write(path) as unfinished, open(unfinished, "wb") as file:
            np.savez(
                file,
                optical_depth=self.optical_depth.numpy(),
                depths_m=self.depths_m.numpy(),
                margin_px=self.margin_px,
                mirrored=self.mirrored,
            )

    @classmethod
    def load(cls, path: Path) -> MaskBank:
        with np.load(path) as stored:
            return cls(
                torch.from_numpy(stored["optical_depth"]),
                torch.from_numpy(stored["depths_m"]),
                int(stored["margin_px"]),
                bool(stored["mirrored"]),
            )

    def mask(self, depth_m: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Particle mask ``(1, H, W)`` in front of a scene ``depth_m (1, H, W)``: entry 0 as it is without generator."""
        height, width = depth_m.shape[-2:]
        entry, top, left = 0, self.margin_px, self.margin_px
        turned: list[int] = []
        if generator is not None:
            pick = torch.randint(0, 2**31, (5,), generator=generator).tolist()
            entry = pick[0] % len(self.optical_depth)
            top, left = pick[1] % (2 * self.margin_px + 1), pick[2] % (2 * self.margin_px + 1)
            turned = [axis for axis, toss in ((-1, pick[3]), (-2, pick[4] if self.mirrored else 0)) if toss % 2]
        window = self.optical_depth[entry, :, top : top + height, left : left + width]
        if turned:
            window = window.flip(turned)
        first, last = float(self.depths_m[0].log()), float(self.depths_m[-1].log())
        steps = len(self.depths_m) - 1
        place = ((depth_m.log() - first) * (steps / (last - first))).clamp(0, steps)
        near = place.floor().clamp_max(steps - 1)
        class_of = near.long()
        low = window.gather(0, class_of).float()
        high = window.gather(0, class_of + 1).float()
        return -torch.expm1(-torch.lerp(low, high, place - near))
