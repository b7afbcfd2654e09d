"""See rain on a LiDAR point cloud, with no data of your own.

    python examples/first_lidar_rain.py
    python examples/first_lidar_rain.py --sensor velodyne-hdl-64e --rate 25 --columns 2083

Scans the embedded scene, lets it rain 50 mm/h, counts what became of the points, and draws both clouds from above:
drops near the sensor, and lost points where surfaces are dark or far.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import torch

import torchweather as tw
from torchweather.io import atomic_write
from torchweather.scenes import lidar_view, test_track

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--sensor", default="ouster-os1-128", help="a preset with a scan pattern")
parser.add_argument("--columns", type=int, default=512, help="columns of the scan; fewer is quicker")
parser.add_argument("--rate", type=float, default=50.0, help="mm/h")
parser.add_argument("--out", type=Path, default=Path("first_lidar_rain.png"), help="picture to write")
arguments = parser.parse_args()

sensor = tw.Lidar.preset(arguments.sensor, columns=arguments.columns)
view = lidar_view(test_track(), sensor)
rain = tw.LidarRain(tw.Rain(rate_mm_per_h=arguments.rate), sensor)
noise = rain.draw(view.points, seed=7)  # the same storm on every machine
result = rain.run(view.points, noise, directions=view.directions)  # beams without return get drops too
assert isinstance(result.points, torch.Tensor)
assert isinstance(result.kind, torch.Tensor)

clear = view.hit
drops = result.kind == tw.PointKind.PARTICLE
lost = clear & (result.kind == tw.PointKind.LOST)
print(f"{arguments.sensor}, {len(view.points)} beams, {int(clear.sum())} returns in clear air")
print(f"rain of {arguments.rate:g} mm/h")
print(f"drops instead of an object: {int((drops & clear).sum())}; in empty beams: {int((drops & ~clear).sum())}")
print(f"lost: {int(lost.sum())}; extinction {float(rain.extinction_per_m):.2e} 1/m")

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  # after the backend is chosen

figure, axes = plt.subplots(1, 2, figsize=(11, 5), layout="constrained", sharex=True, sharey=True)
for axis, points, shown, title in (
    (axes[0], view.points, clear, "clear air"),
    (axes[1], result.points, result.kind == tw.PointKind.OBJECT, f"rain of {arguments.rate:g} mm/h"),
):
    axis.scatter(points[shown, 0], points[shown, 1], s=0.3, c="0.4", label="objects")
    axis.set(xlabel="x, forward, in m", ylabel="y, left, in m", title=title, xlim=(-10, 60), ylim=(-25, 25))
axes[1].scatter(view.points[lost, 0], view.points[lost, 1], s=0.5, c="C1", label="lost")
axes[1].scatter(result.points[drops, 0], result.points[drops, 1], s=3, c="C3", label="drops")
axes[1].legend(markerscale=5, loc="upper right")
with atomic_write(arguments.out) as unfinished:
    figure.savefig(unfinished, dpi=110)
plt.close(figure)
print(f"picture: {arguments.out}")
