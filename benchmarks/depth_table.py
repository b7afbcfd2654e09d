"""The tables of docs/depth-figures.md from depth_completion.json, scene_prior.json and sky_mask.json.

python benchmarks/depth_table.py            # writes the page
python benchmarks/depth_table.py --check    # exit code 1 where the page does not say what the files say
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "depth-figures.md"
VISIBILITIES_M = (1000, 500, 200, 100, 50)
RANGES = ("0 to 10 m", "10 to 20 m", "20 to 40 m", "40 to inf m", "all")
METHODS = {
    "DepthFromPoints nearest": "nearest point",
    "DepthFromPoints linear": "`DepthFromPoints` (before)",
    "CompletedDepth without the picture": "`CompletedDepth`, no picture",
    "CompletedDepth": "`CompletedDepth`",
}
PRIORS = {
    "flat_ground": "`FlatGround` (before)",
    "scene_prior": "`ScenePrior`",
    "scene_prior_and_boxes": "`ScenePrior` with boxes",
}


def table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def completion(found: dict[str, Any]) -> str:
    rows = []
    for method, name in METHODS.items():
        by = found["reported"][method]
        for place in RANGES:
            one = by["left_out_rings"]["all"] if place == "all" else by["left_out_rings"]["by_range"][place]
            rows.append(
                [
                    name,
                    place.replace("to inf m", "m and more"),
                    f"{one['median_percent']:.2f} %",
                    f"{one['p90_percent']:.1f} %",
                    f"{one['over_25_percent']:.1f} %",
                    f"{by['edge_score']:.2f}" if place == "all" else "",
                    f"{found['times_ms'][method]['median_ms']:.0f}" if place == "all" else "",
                ]
            )
    return table(["depth", "range", "median", "90 %", "more than 25 % off", "edges", "ms"], rows)


def prior(found: dict[str, Any]) -> str:
    rows = []
    for method, name in PRIORS.items():
        one = found["depth"][method]["others"]
        levels = [f"{one[f'levels_{metres}_m']:.1f}" for metres in VISIBILITIES_M]
        shares = [f"{100 * one[key]:.0f} %" for key in ("within_1.25", "within_2")]
        rows.append([name, f"{100 * one['median_relative_error']:.0f} %", *shares, *levels])
    header = ["depth", "median error", "within 1.25", "within 2", *(f"{metres} m" for metres in VISIBILITIES_M)]
    return table(header, rows)


def sky(found: dict[str, Any]) -> str:
    rows = [
        [name, f"{one['mean_iou']:.3f}", f"{one['median_iou']:.3f}", str(one["frames_with_sky"])]
        for name, one in (("chosen on", found["chosen_on"]), ("other half", found["other_half"]))
    ]
    return table(["frames", "mean IoU", "median IoU", "with sky"], rows)


def page() -> str:
    completed, guessed, masked = (
        json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))
        for name in ("depth_completion", "scene_prior", "sky_mask")
    )
    horizon, bonnet = guessed["horizon"]["others"], guessed["bonnet"]
    frames = completed["frames"]["reported"]
    without = masked["all"]["greatest_false_sky_percent"]
    return f"""# How good is the depth of a photograph?

Measured on real frames that cannot be shipped: 13 frames of KITTI with their LiDAR, 14 of a dash camera, roadside
frames. Methods were chosen on one half of the frames; the other half is reported. `python benchmarks/depth_table.py`
makes this page from the files of the three benchmarks.

## LiDAR completed

Every fourth ring of the sweep is left out, in turn, and the completion of the others is compared with its points.
Points that the camera does not see are not compared. `edges` is the picture's gradient at the steps of the depth over
its mean: 1 is chance, more is better. Milliseconds are of 1242 x 375 px, one thread. Frames reported:
{", ".join(frames)}.

{completion(completed)}

## No depth at all

Depth guessed from the picture, compared with the LiDAR's returns; and fog rendered with it: mean difference, in levels
of 255, to fog rendered with completed LiDAR and a sky drawn by hand.

{prior(guessed)}

The horizon is off by {horizon["off_px"]:.1f} px, the principal point alone by {horizon["principal_point_off_px"]:.1f}.
The own bonnet is found in {bonnet["found"]} of {bonnet["with_bonnet"]} frames,
with {bonnet["false_alarms"]} false alarms in {bonnet["without"]} others.

## Sky

Masks from the picture alone against masks drawn by hand. False sky on frames without sky: {without:.1f} %.

{sky(masked)}

The worst frame shows a white wall against a white sky, which have no edge. Night skies are never found.
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only compare")
    arguments = parser.parse_args()
    text = page()
    if arguments.check:
        return int(PAGE.read_text(encoding="utf-8") != text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
