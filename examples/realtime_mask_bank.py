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

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import torch
from parts.mask_bank import NEAR_M, MaskBank
from parts.shared import command_line
from torch import Tensor

import torchweather as tw
from torchweather.atmosphere.weather import Rain, Snow, parse_weather
from torchweather.camera.particles.veil import REFLECTED_SHARE
from torchweather.image import cfa_index, colour_means, develop
from torchweather.io import write_image
from torchweather.scenes import test_track


def composed(bayer: Tensor, mask: Tensor, colour: Tensor, cfa: Tensor) -> Tensor:
    """The frame behind its particles: ``(1 - M) I + M C`` per CFA colour, linear in light."""
    return torch.lerp(bayer, colour[cfa], mask)


def particle_colour(weather: Rain | Snow, bayer: Tensor, sky: Tensor, pattern: str) -> Tensor:
    """What a particle shows, ``(3,)``: a drop the scene and a little sky, a flake the mean of sky and ground."""
    if isinstance(weather, Snow):
        ground = colour_means(bayer[..., bayer.shape[-2] // 4 * 2 :, :], pattern)  # the lower half, whole cells
        return weather.albedo * (sky + ground) / 2
    return (1 - REFLECTED_SHARE) * colour_means(bayer, pattern) + REFLECTED_SHARE * sky


def median_ms(call: Callable[[], object], repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    parser = command_line(__doc__)
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
