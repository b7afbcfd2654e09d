"""Completion of LiDAR depth on real frames: left-out rings by range, edges, time.

    TORCHWEATHER_REAL_DATA=... python benchmarks/depth_completion.py --out benchmarks/depth_completion.json

Every fourth ring of the sweep is left out, once for each of the four phases, and the completion of the others is
compared with its points at their pixels. Points that the camera does not see are not compared: those with nearer ones
on two opposite sides, by the rule of `hidden_points` on ALL points. Constants of the surfaces and steps
were chosen on every second frame (``chosen``); the other frames are ``reported``. The reach of the search for hidden
points, and what lies above the scan, were chosen on views of all frames.

The edge score is the picture's gradient at the steps of the completed depth over its mean: 1 is chance, more is
better. Times are of one thread, of all points.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from measure import hand_over, machine, times_ms
from torch import Tensor

from torchweather.camera.depth.completion import CompletedDepth
from torchweather.camera.depth.hidden_points import hidden_points
from torchweather.camera.depth.points import DepthFromPoints
from torchweather.camera.depth.projection import project_points
from torchweather.datasets import read_kitti_calibration, read_kitti_points
from torchweather.io import read_image
from torchweather.sensors import Camera

PHASES = 4
RANGES_M = (0.0, 10.0, 20.0, 40.0, np.inf)
# Neighbours whose depths differ by more than this ratio are a step.
STEP = 1.25

Method = Callable[["Frame", Tensor], np.ndarray]


class Frame:
    """One frame with its cloud, projected, and the ring of every point."""

    def __init__(self, root: Path, name: str) -> None:
        known = read_kitti_calibration(root / f"calib/{name}.txt")
        self.rgb = read_image(root / f"image_2/{name}.png")[0]
        self.height, self.width = self.rgb.shape[-2:]
        fx, fy, cx, cy = (float(known.camera_matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
        self.camera = Camera.from_intrinsics(fx, fy, cx, cy, self.width, self.height)
        self.transform = known.T_camera_from_lidar
        self.points = read_kitti_points(root / f"velodyne/{name}.bin").double()
        # The file goes ring by ring; each begins where azimuth wraps around.
        azimuth = np.mod(torch.atan2(self.points[:, 1], self.points[:, 0]).numpy(), 2 * np.pi)
        self.ring = np.concatenate([[0], np.cumsum(np.diff(azimuth) < -np.pi)])
        place = project_points(self.points, self.transform, self.camera, self.height, self.width)
        column, row, depth_m, seen = (value.numpy() for value in place)
        hidden = np.zeros(len(depth_m), bool)
        hidden[seen] = hidden_points(column[seen], row[seen], depth_m[seen], self.height, self.width)
        self.compared = seen & ~hidden
        self.hidden_share = float(hidden[seen].mean())
        self.column, self.row, self.depth_m = column, row, depth_m
        self.top = int(row[seen].min())


def no_sky(rgb: Tensor, **_: object) -> Tensor:
    return torch.zeros(1, *rgb.shape[-2:])


def today(fill: str) -> Method:
    def method(frame: Frame, points: Tensor) -> np.ndarray:
        source = DepthFromPoints(points, frame.transform, fill=fill)
        return source(frame.camera, frame.height, frame.width)[0].numpy()

    return method


def completed(with_picture: bool) -> Method:
    def method(frame: Frame, points: Tensor) -> np.ndarray:
        source = CompletedDepth(points, frame.transform, sky=no_sky)
        picture = frame.rgb if with_picture else None
        return source(frame.camera, frame.height, frame.width, image=picture)[0].numpy()

    return method


METHODS = {
    "DepthFromPoints linear": today("linear"),
    "DepthFromPoints nearest": today("nearest"),
    "CompletedDepth without the picture": completed(with_picture=False),
    "CompletedDepth": completed(with_picture=True),
}


def summary(error: np.ndarray) -> dict[str, float]:
    """Figures in percent; infinite depth counts as wholly off."""
    return {
        "median_percent": round(100 * float(np.median(error)), 2),
        "p90_percent": round(100 * float(np.quantile(error, 0.9)), 2),
        "over_25_percent": round(100 * float((error > 0.25).mean()), 2),
        "points": len(error),
    }


def left_out(frames: list[Frame], method: Method) -> dict[str, Any]:
    errors, depths = [], []
    for frame in frames:
        for phase in range(PHASES):
            out = frame.ring % PHASES == phase
            found = method(frame, frame.points[torch.from_numpy(~out)])
            at = out & frame.compared
            truth = frame.depth_m[at]
            value = found[np.rint(frame.row[at]).astype(int), np.rint(frame.column[at]).astype(int)]
            errors.append(np.abs(value - truth) / truth)
            depths.append(truth)
    error, depth_m = np.concatenate(errors), np.concatenate(depths)
    bins = {
        f"{low:g} to {high:g} m": summary(error[(depth_m >= low) & (depth_m < high)])
        for low, high in pairwise(RANGES_M)
    }
    return {"all": summary(error), "by_range": bins}


def edge_score(frame: Frame, depth_m: np.ndarray) -> float:
    """Picture's gradient at depth steps, largest within a pixel, over its mean; below the scan's upper edge."""
    picture = frame.rgb.numpy().astype(np.float64)[:, frame.top :]
    log_depth = np.log(np.minimum(depth_m[frame.top :], 1e3))
    at_steps, everywhere = [], []
    for axis in (0, 1):
        gradient = np.abs(np.diff(picture, axis=axis + 1)).max(0)
        before, after = np.roll(gradient, 1, axis), np.roll(gradient, -1, axis)
        gradient = np.maximum(gradient, np.maximum(before, after))
        step = np.abs(np.diff(log_depth, axis=axis)) > np.log(STEP)
        at_steps.append(gradient[step])
        everywhere.append(gradient.ravel())
    return float(np.concatenate(at_steps).mean() / np.concatenate(everywhere).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    root = Path(os.environ["TORCHWEATHER_REAL_DATA"]) / "kitti_13"
    names = sorted(path.stem for path in (root / "velodyne").glob("*.bin"))
    halves = {"chosen": names[::2], "reported": names[1::2]}
    result: dict[str, Any] = {"what": " ".join((__doc__ or "").split()), "machine": machine(), "frames": halves}
    for half, chosen in halves.items():
        frames = [Frame(root, name) for name in chosen]
        result[half] = {"hidden_percent": round(100 * float(np.mean([frame.hidden_share for frame in frames])), 1)}
        for name, method in METHODS.items():
            scores = [edge_score(frame, method(frame, frame.points)) for frame in frames]
            result[half][name] = {
                "left_out_rings": left_out(frames, method),
                "edge_score": round(float(np.mean(scores)), 2),
            }
    frame = Frame(root, names[1])
    result["size"] = [frame.height, frame.width]
    result["times_ms"] = {
        name: times_ms(lambda method=method: method(frame, frame.points), arguments.repeats)
        for name, method in METHODS.items()
    }
    hand_over(result, arguments.out)


if __name__ == "__main__":
    main()
