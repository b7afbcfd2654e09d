"""See rain on a list of radar detections, with no data of your own.

    python examples/first_radar_rain.py
    python examples/first_radar_rain.py --sensor imaging-77ghz --rate 100 --seed 3

A simulated FMCW radar looks at the embedded scene in clear air and reports its points. `RadarAttenuation` lets it rain
on that list: every point weaker by the way through the rain and back, the weakest lost. Beside it, the same scene with
the rain in the samples themselves. The picture shows the points from above, and their powers against range with the
detection threshold.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import torch

import torchweather as tw
from torchweather.io import atomic_write
from torchweather.radar import FmcwRadar
from torchweather.scenes import radar_view, test_track

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--sensor", default="awr1843-like", help="a radar preset")
parser.add_argument("--rate", type=float, default=50.0, help="mm/h")
parser.add_argument("--seed", type=int, default=7, help="of noise and rain")
parser.add_argument("--out", type=Path, default=Path("first_radar_rain.png"), help="picture to write")
arguments = parser.parse_args()

clear_air = FmcwRadar(tw.Radar.preset(arguments.sensor))
radar = clear_air.list_sensor  # with the noise floor of its own list
scatterers = radar_view(test_track(), radar).scatterers
points = clear_air(scatterers, clear_air.draw(scatterers, seed=arguments.seed))
assert isinstance(points, torch.Tensor)

weather = tw.Rain(rate_mm_per_h=arguments.rate)
rain = tw.RadarAttenuation(weather, radar)
result = rain.run(points, rain.draw(points, seed=arguments.seed))
assert isinstance(result.points, torch.Tensor)
assert isinstance(result.kind, torch.Tensor)
assert isinstance(result.attenuation_db, torch.Tensor)
lost = result.kind == tw.PointKind.LOST

in_the_samples = FmcwRadar(radar, weather)
simulated = in_the_samples(scatterers, in_the_samples.draw(scatterers, seed=arguments.seed))
assert isinstance(simulated, torch.Tensor)

print(f"{arguments.sensor}: {len(scatterers.field_m)} scatterers, {len(points)} points in clear air")
print(f"rain of {arguments.rate:g} mm/h: {float(rain.attenuation_db_per_km):.2f} dB/km one way")
print(f"on the list: two-way loss up to {float(result.attenuation_db.max()):.2f} dB, {int(lost.sum())} points lost")
print(f"in the samples: {len(simulated)} points, those of the rain itself among them")

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  # after the backend is chosen

range_m = torch.linalg.vector_norm(points[:, :3], dim=1)
figure, axes = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
axes[0].scatter(points[:, 0], points[:, 1], s=20, c="0.6", label="clear air")
axes[0].scatter(result.points[~lost, 0], result.points[~lost, 1], s=6, c="C0", label="rain on the list")
axes[0].scatter(points[lost, 0], points[lost, 1], s=30, c="C3", marker="x", label="lost")
axes[0].scatter(simulated[:, 0], simulated[:, 1], s=30, facecolors="none", edgecolors="C1", label="rain in the samples")
axes[0].set(xlabel="x, forward, in m", ylabel="y, left, in m", xlim=(0, 80), ylim=(-25, 25))
axes[1].scatter(range_m, points[:, 4], s=20, c="0.6", label="clear air")
axes[1].scatter(range_m, result.points[:, 4], s=6, c="C0", label=f"rain of {arguments.rate:g} mm/h on the list")
axes[1].axhline(radar.floor_db + radar.detection_snr_db, c="C3", lw=1, label="detection threshold")
axes[1].set(xlabel="range in m", ylabel="power in dBm")
for axis in axes:
    axis.legend(loc="upper right", fontsize=8)
with atomic_write(arguments.out) as unfinished:
    figure.savefig(unfinished, dpi=110)
plt.close(figure)
print(f"picture: {arguments.out}")
