"""A script of a user: `mypy --strict` checks it from outside, and it runs."""

from __future__ import annotations

import torch
from torch import Tensor

import torchweather as tw

camera = tw.Camera.preset("lucid-triton", width=64, height=48, exposure_s=0.01)
rain = tw.BayerRain(tw.Rain(rate_mm_per_h=25.0), camera, depth=30.0, airlight=0.7)
frame = torch.full((1, camera.height, camera.width), 0.2)
wet: Tensor = rain(frame, seed=7)
mask: Tensor = rain.run(frame, seed=7).particle_mask
noise: dict[str, Tensor] = rain.draw(frame, seed=7)

picture: Tensor = tw.AsBayer(rain)(torch.full((3, 48, 64), 0.2))

lidar = tw.Lidar.preset("velodyne-hdl-64e", max_range_m=80.0)
cloud = tw.LidarSnow(tw.Snow(rate_mm_per_h=1.0), lidar)(torch.tensor([[9.0, 1.0, 0.5, 40.0]]))
points: Tensor = cloud if isinstance(cloud, Tensor) else cloud[0]

together = tw.Compose({"image": rain}, weather=tw.Rain(rate_mm_per_h=(1.0, 50.0)))
sample = together({"image": frame}, seed=1)
seen: Tensor = sample["image"]
