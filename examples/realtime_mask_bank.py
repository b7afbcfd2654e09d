"""Put rain or snow on a camera stream in real time, from a stored bank of particle masks.

    python examples/realtime_mask_bank.py                      # makes the bank, then plays frames from it
    python examples/realtime_mask_bank.py --bank bank.npz      # keeps the bank, and reads it the next time
    python examples/realtime_mask_bank.py --weather snow:rate=2

A frame rendered particle by particle takes a fraction of a second. Its particle mask depends on the weather and the
camera, not on what the camera sees, except that an object hides the particles behind it. So the optical depth of the
particles can be rendered beforehand for a few depths of the scene, and a frame then costs a look-up: D3.4 section 7.6
suggests such a bank. Each frame takes a random entry, a random window of it and a random mirror image.

What is lost against the full render: a finite number of draws (the same streaks come back); one rate for the whole
bank; particles between two stored depths are shared out in proportion to ln(depth); half precision; no motion from
frame to frame (see ``drive_in_snow.py``); mirroring up and down is right for a level camera in still air only, and is
left out otherwise; windows need a lens without distortion.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Rain, Snow, parse_weather
from torchweather.camera.particles.veil import REFLECTED_SHARE
from torchweather.image import cfa_index, colour_means, develop
from torchweather.io import atomic_write, write_image
from torchweather.scenes import test_track

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


def composed(bayer: Tensor, mask: Tensor, colour: Tensor, cfa: Tensor) -> Tensor:
    """The frame behind its particles: ``(1 - M) I + M C`` per CFA colour, linear in light."""
    return torch.lerp(bayer, colour[cfa], mask)


def particle_colour(weather: Rain | Snow, bayer: Tensor, sky: Tensor, pattern: str) -> Tensor:
    """What a particle shows, ``(3,)``: a drop the scene and a little sky, a flake the light of the sky."""
    if isinstance(weather, Snow):
        return weather.albedo * sky
    return (1 - REFLECTED_SHARE) * colour_means(bayer, pattern) + REFLECTED_SHARE * sky


def median_ms(call: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weather", default="rain:rate=50", help="rain:rate=... or snow:rate=...")
    parser.add_argument("--bank", type=Path, help="file of the bank; read where it exists, else written")
    parser.add_argument("--entries", type=int, default=6, help="draws in the bank")
    parser.add_argument("--depths", type=int, default=8, help="depths at which each draw is stored")
    parser.add_argument("--margin", type=int, default=16, help="px by which a window can be moved")
    parser.add_argument("--width", type=int, default=484, help="pixels")
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("realtime_mask_bank.png"), help="picture: bank, full render")
    arguments = parser.parse_args()

    weather = parse_weather(arguments.weather)
    if not isinstance(weather, (Rain, Snow)):
        parser.error(f"--weather: a bank holds particles: rain or snow; got {arguments.weather}")
    width = arguments.width // 2 * 2
    camera = tw.Camera.preset("lucid-triton").resized(width, round(width * 0.378) * 2)
    far_m = 80.0 if weather.kind == "rain" else 30.0

    if arguments.bank is not None and arguments.bank.exists():
        bank = MaskBank.load(arguments.bank)
        print(f"bank read from {arguments.bank}")
    else:
        start = time.perf_counter()
        bank = MaskBank.rendered(weather, camera, arguments.entries, arguments.depths, arguments.margin, far_m)
        print(f"bank rendered in {time.perf_counter() - start:.1f} s", end="")
        if arguments.bank is not None:
            bank.save(arguments.bank)
        print(f", {bank.optical_depth.numel() * 2 / 1e6:.0f} MB" + (f": {arguments.bank}" if arguments.bank else ""))

    view = test_track().view(camera)
    cfa = cfa_index(camera.height, camera.width, camera.bayer_pattern)
    full = tw.BayerWeather(weather, camera, near_m=NEAR_M, far_m=far_m)
    generator = torch.Generator().manual_seed(7)
    noise = full.draw(view.bayer, generator=generator)
    exact = full.run(view.bayer, view.depth_m, noise)
    sky = exact.airlight  # in a stream: from its last frames

    def frame() -> Tensor:
        colour = particle_colour(weather, view.bayer, sky, camera.bayer_pattern)
        return composed(view.bayer, bank.mask(view.depth_m, generator), colour, cfa)

    frame()
    fast = median_ms(frame, arguments.frames)
    slow = median_ms(lambda: full(view.bayer, view.depth_m), max(3, arguments.frames // 10))
    means = torch.stack([bank.mask(view.depth_m, generator).mean() for _ in range(arguments.frames)])
    print(f"{camera.width} x {camera.height} px: {fast:.1f} ms a frame from the bank, {slow:.0f} ms rendered in full")
    print(
        f"mask mean {float(means.mean()):.4f} from the bank, {float(exact.particle_mask.mean()):.4f} in full; "
        f"{len(bank.optical_depth)} draws, then streaks come back"
    )
    pair = torch.cat([develop(bayer, camera.bayer_pattern, exposure=1.4) for bayer in (frame(), exact.bayer)], -1)
    write_image(arguments.out, (pair * 255).round().to(torch.uint8))
    print(f"picture, bank left and full render right: {arguments.out}")


if __name__ == "__main__":
    main()
