"""Fog in banks on all sensors of a vehicle, with no data of your own.

    python examples/fog_banks.py
    python examples/fog_banks.py --mor 60 --log-std 0.5 --length 15 --seed 4

The embedded scene, seen by a camera, a LiDAR and a radar in one sample: first in fog of one density, then in fog whose
density changes over the ground, with the same mean. All sensors look into the same banks. The picture shows the density
from above with the scan's returns in it, and both frames of the camera.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import matplotlib
import torch

import torchweather as tw
from torchweather.atmosphere.density_field import PatchyAir
from torchweather.core.random import draw_variates
from torchweather.image import develop
from torchweather.io import atomic_write
from torchweather.scenes import lidar_view, test_track

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--mor", type=float, default=120.0, help="visibility of the mean density, m")
parser.add_argument("--log-std", type=float, default=0.7, help="spread of the logarithm of the density")
parser.add_argument("--length", type=float, default=15.0, help="over which the density changes, m")
parser.add_argument("--seed", type=int, default=44, help="of the sample")
parser.add_argument("--width", type=int, default=480, help="of the camera's frame, pixels")
parser.add_argument("--columns", type=int, default=512, help="of the LiDAR's scan")
parser.add_argument("--out", type=Path, default=Path("fog_banks.png"), help="picture to write")
arguments = parser.parse_args()
RADAR_M = (20.0, 45.0)  # two targets

camera = tw.Camera.preset("lucid-triton").resized(arguments.width // 2 * 2, round(arguments.width * 0.378) * 2)
lidar = tw.Lidar.preset("ouster-os1-128", columns=arguments.columns)
radar = tw.Radar.preset("imaging-77ghz")
view, scan = test_track().view(camera), lidar_view(test_track(), lidar)
detections = torch.tensor([[x, 0.0, 0.0, 0.0, -80.0, 10.0] for x in RADAR_M])
sample = {"image": view.bayer, "depth": view.depth_m, "points": scan.points, "radar": detections}

even = tw.Fog(mor_m=arguments.mor)
banks = tw.Fog(mor_m=arguments.mor, patch_log_std=arguments.log_std, patch_length_m=arguments.length)
frames, results = {}, {}
for name, fog in (("one density", even), ("banks", banks)):
    weather = tw.Compose(
        {"image": tw.BayerFog(fog, camera), "points": tw.LidarFog(fog, lidar), "radar": tw.RadarAttenuation(fog, radar)}
    )
    out, results[name] = weather.run(sample, seed=arguments.seed)
    frames[name] = develop(out["image"], camera.bayer_pattern, exposure=1.3)

print(f"fog of {arguments.mor:g} m: two-way transmission of the LiDAR's beams; the radar's loss {RADAR_M} m ahead")
for name, result in results.items():
    seen = result["points"].transmission[scan.hit]
    loss_db = ", ".join(f"{float(db):.4f}" for db in result["radar"].attenuation_db)
    print(f"{name:>12}: {float(seen.mean()):.3f} on average, {float(seen.std()):.3f} spread; {loss_db} dB")

# The field of this sample once more, for the picture: Compose draws it from the sample's seed as the air's own.
air = PatchyAir(arguments.length)
drawn = draw_variates([arguments.seed], "air", air.variates(), {})
field = air.field({name.removeprefix("air."): torch.from_numpy(values) for name, values in drawn.items()})
density = field.banks(banks).density[0]
azimuth = torch.linspace(-math.pi, math.pi, density.shape[0])
range_m = field.step_m * torch.arange(density.shape[1])

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  # after the backend is chosen

figure = plt.figure(figsize=(9.4, 5.6), layout="compressed")
grid = figure.add_gridspec(2, 2, width_ratios=(1.0, 0.85))
above, first, second = (figure.add_subplot(grid[place]) for place in ((slice(None), 0), (0, 1), (1, 1)))
x, y = azimuth.cos()[:, None] * range_m, azimuth.sin()[:, None] * range_m
shown = above.pcolormesh(x.numpy(), y.numpy(), density.numpy(), cmap="Blues", shading="gouraud", vmin=0.0, vmax=3.0)
figure.colorbar(shown, ax=above, label="density over its mean", location="bottom", shrink=0.8)
points, kind = results["banks"]["points"].points.numpy(), results["banks"]["points"].kind.numpy()
for what, colour, size, label in (
    (tw.PointKind.OBJECT, "0.15", 0.3, "objects seen"),
    (tw.PointKind.PARTICLE, "C1", 0.5, "returns of fog"),
):
    there = kind == what
    above.scatter(points[there, 0], points[there, 1], s=size, c=colour, label=label)
clear = scan.points.numpy()
gone = scan.hit.numpy() & (kind != tw.PointKind.OBJECT)
above.scatter(clear[gone, 0], clear[gone, 1], s=0.3, c="C3", label="objects lost")
half = math.atan(0.5 * camera.width / camera.fx)
for side in (-half, half):
    above.plot([0, 80 * math.cos(side)], [0, 80 * math.sin(side)], c="0.3", lw=0.8, ls="--")
above.set(xlabel="x, forward, in m", ylabel="y, left, in m", xlim=(-20, 50), ylim=(-35, 35), aspect="equal")
above.set_title("banks from above; dashed: the camera's view")
above.legend(markerscale=8, loc="upper left", fontsize=8)
for axis, name in ((first, "one density"), (second, "banks")):
    axis.imshow(frames[name].permute(1, 2, 0).clamp(0, 1).numpy())
    axis.set_axis_off()
    axis.set_title(f"fog of {arguments.mor:g} m, {name}")
with atomic_write(arguments.out) as unfinished:
    figure.savefig(unfinished, dpi=110)
plt.close(figure)
print(f"picture: {arguments.out}")
