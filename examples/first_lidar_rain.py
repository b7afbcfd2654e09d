"""See rain on a LiDAR point cloud, with no data of your own.

    python examples/first_lidar_rain.py
    python examples/first_lidar_rain.py --sensor velodyne-hdl-64e --rate 25 --columns 2083

Scans the embedded scene, lets it rain 50 mm/h, counts what became of the points, and draws both clouds from above and
from the side: drops near the sensor and over the road, and lost points where surfaces are dark or far.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import torch

import torchweather as tw
from torchweather.io import atomic_write
from torchweather.lidar import fit_ground
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

ground = fit_ground(view.points[clear, :3].numpy())  # height of the road under the sensor
figure, axes = plt.subplots(2, 2, figsize=(11, 7.5), layout="constrained", sharex=True, height_ratios=(5, 2))
for column, points, shown, title in (
    (0, view.points, clear, "clear air"),
    (1, result.points, result.kind == tw.PointKind.OBJECT, f"rain of {arguments.rate:g} mm/h"),
):
    for row, (name, limits) in enumerate((("y, left, in m", (-25, 25)), ("z, up, in m", (-4, 8)))):
        axis = axes[row, column]
        axis.scatter(points[shown, 0], points[shown, 1 + row], s=0.3, c="0.4", label="objects")
        axis.set(ylabel=name, xlim=(-10, 60), ylim=limits)
        if column == 1:
            axis.scatter(view.points[lost, 0], view.points[lost, 1 + row], s=0.5, c="C1", label="lost")
            axis.scatter(result.points[drops, 0], result.points[drops, 1 + row], s=3, c="C3", label="drops")
    if ground is not None:  # nothing can be below it
        axes[1, column].axhspan(-4, ground.height_m, color="#f1e8dc", zorder=0)
    axes[0, column].set_title(title)
    axes[1, column].set_xlabel("x, forward, in m")
axes[0, 1].legend(markerscale=5, loc="upper right")
with atomic_write(arguments.out) as unfinished:
    figure.savefig(unfinished, dpi=110)
plt.close(figure)
print(f"picture: {arguments.out}")
