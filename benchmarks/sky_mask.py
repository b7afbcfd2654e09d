"""Sky masks of real photographs compared with masks drawn by hand: overlap, false sky, time.

    TORCHWEATHER_REAL_DATA=/path/to/real OMP_NUM_THREADS=1 python benchmarks/sky_mask.py --out benchmarks/sky_mask.json

The folder of truth masks (``--truth``, by default ``sky_truth`` of the real data) holds one PNG a frame: 255 sky, 0 no
sky, everything else left out of every score. Nothing but the pictures goes in: no horizon, no LiDAR. The constants of
the mask were chosen on every second frame of the sorted names; the other half was looked at, and one constant was
dropped because of it (the least area of a region, frame 000020).
"""

from __future__ import annotations

import argparse
import os
import re
import statistics
import time
from pathlib import Path
from typing import Any

import torch
from measure import hand_over, machine, times_ms

from torchweather.camera.depth.sky import sky_mask
from torchweather.io import read_image

WITHOUT_SKY = 1e-4  # share of the picture


def photograph_of(name: str, real: Path) -> Path | None:
    """The photograph that a truth mask belongs to."""
    camera = re.fullmatch(r"roadcam_(\d{4})(\d\d)(\d\d)_(\d\d)(\d\d)", name)
    patterns = [f"kitti_13/image_2/{name}.png", f"dashcam_highway/{name}.jpg", f"kitti_nuscenes_demo/*/{name}.*"]
    if camera:
        year, month, day, hour, minute = camera.groups()
        patterns.append(f"roadcam_fog/frames/{year}{month}{day}/{year}-{month}-{day}-{hour}-{minute}.jpg")
    found = [path for pattern in patterns for path in sorted(real.glob(pattern))]
    return found[0] if found else None


def score(photograph: Path, truth: Path, repeats: int) -> dict[str, Any]:
    """Scores of one frame; shares in percent of the scored pixels."""
    rgb, _ = read_image(photograph)
    drawn = read_image(truth)[0][:1]
    drawn = (255 * drawn).round() if drawn.is_floating_point() else drawn
    share = sky_mask(rgb)
    scored, sky, found = (drawn == 255) | (drawn == 0), drawn == 255, share >= 0.5
    union = int(((found | sky) & scored).sum())
    pixels = int(scored.sum())
    return {
        "size": f"{rgb.shape[-1]} x {rgb.shape[-2]}",
        "sky_percent": round(100 * int((sky & scored).sum()) / pixels, 2),
        "iou": round(int((found & sky & scored).sum()) / union, 4) if union else 1.0,
        "false_sky_percent": round(100 * int((found & ~sky & scored).sum()) / pixels, 3),
        "missed_sky_percent": round(100 * int((~found & sky & scored).sum()) / pixels, 3),
        "mean_error_of_share_percent": round(100 * float((share - sky.float()).abs()[scored].mean()), 3),
        **times(rgb, repeats),
    }


def times(rgb: torch.Tensor, repeats: int) -> dict[str, float]:
    """Wall time of a call, and processor time, which other programs on the machine disturb less; milliseconds."""
    if not repeats:
        return {}
    wall = times_ms(lambda: sky_mask(rgb), repeats)["median_ms"]
    start = time.process_time()
    for _ in range(repeats):
        sky_mask(rgb)
    return {"ms": wall, "processor_ms": round(1e3 * (time.process_time() - start) / repeats, 1)}


def summary(frames: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Mean and median overlap of the frames with sky, and the greatest false sky of those without."""
    least = 100 * WITHOUT_SKY
    overlaps = [frame["iou"] for frame in frames.values() if frame["sky_percent"] > least]
    bare = [frame["false_sky_percent"] for frame in frames.values() if frame["sky_percent"] <= least]
    return {
        "frames_with_sky": len(overlaps),
        "mean_iou": round(statistics.mean(overlaps), 4) if overlaps else None,
        "median_iou": round(statistics.median(overlaps), 4) if overlaps else None,
        "frames_without_sky": len(bare),
        "greatest_false_sky_percent": max(bare, default=None),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, default=os.environ.get("TORCHWEATHER_REAL_DATA"), help="real data")
    parser.add_argument("--truth", type=Path, help="folder of truth masks; default: sky_truth of the real data")
    parser.add_argument("--repeats", type=int, default=5, help="timed calls a frame; 0: no times")
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    arguments = parser.parse_args()
    if arguments.real is None:
        parser.error("no real data: pass --real DIR or set TORCHWEATHER_REAL_DATA")
    real = Path(arguments.real)
    torch.set_num_threads(1)

    masks = sorted((arguments.truth or real / "sky_truth").glob("*.png"))
    frames = {}
    for mask in masks:
        photograph = photograph_of(mask.stem, real)
        if photograph is None:
            print(f"{mask.stem}: no photograph of this name, left out")
            continue
        frames[mask.stem] = score(photograph, mask, arguments.repeats)
    names = sorted(frames)
    result = {
        "what": "sky_mask from the picture alone against masks drawn by hand",
        "machine": machine(),
        "chosen_on": summary({name: frames[name] for name in names[::2]}),
        "other_half": summary({name: frames[name] for name in names[1::2]}),
        "all": summary(frames),
        "target": {"mean_iou": 0.913, "median_iou": 0.972, "greatest_false_sky_percent": 0.0, "ms": 100},
        "frames": frames,
    }
    hand_over(result, arguments.out)


if __name__ == "__main__":
    main()
