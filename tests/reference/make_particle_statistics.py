"""Statistics of the every-particle renderer over many seeds, written to ``particle_statistics.json`` beside this file.

Run ``python tests/reference/make_particle_statistics.py`` (about five minutes on one core, under 1 GB).
Each block holds its settings, the statistics of every seed, their mean and sample standard deviation over the
seeds, and the expectation of the mask mean, that of ``1 - exp(-alpha (depth - near) / cos(theta))`` over the pixels.
"""

from __future__ import annotations

import json
import math
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

# As a script only this file's folder is on the path; the reference is imported as pytest imports it, from the root.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.reference.every_particle import geometric_extinction, population, render_counted, statistics

TARGET = Path(__file__).with_name("particle_statistics.json")
# Lucid Triton TRI028S with a 6 mm lens: 80.8 degrees over 1936 columns, so f = 968 px / tan(40.4 degrees).
F_PX = 968.0 / math.tan(math.radians(40.4))
CROP = {"height": 366, "width": 484, "near_m": 1.5, "depth_m": 30.0, "exposure_s": 0.005, "f_px": F_PX}
SMALL = {"height": 96, "width": 96, "near_m": 1.5, "depth_m": 8.0, "exposure_s": 0.005, "f_px": F_PX}
BLOCKS: dict[str, dict[str, Any]] = {
    "rain_96x96": {"kind": "rain", "rate_mm_per_h": 50.0, **SMALL},
    "rain_484x366": {"kind": "rain", "rate_mm_per_h": 50.0, **CROP},
    "snow_484x366": {"kind": "snow", "rate_mm_per_h": 3.0, **CROP},
    # The lower right corner of the whole picture: 46 degrees off the axis.
    "rain_corner": {"kind": "rain", "rate_mm_per_h": 50.0, **SMALL, "principal_px": [-871.5, -635.5]},
    "snow_corner": {"kind": "snow", "rate_mm_per_h": 3.0, **SMALL, "principal_px": [-871.5, -635.5]},
}
# At least 20; more where a frame is cheap and its statistics are noisy.
N_SEEDS = {"rain_96x96": 100, "rain_484x366": 20, "snow_484x366": 60, "rain_corner": 100, "snow_corner": 100}


def expected_mean(settings: dict[str, Any]) -> float:
    """Mean over the pixels of the covered share that the optical depth of each ray gives."""
    height, width, f_px = settings["height"], settings["width"], settings["f_px"]
    column, row = settings.get("principal_px") or ((width - 1) / 2, (height - 1) / 2)
    y, x = (np.arange(height)[:, None] - row) / f_px, (np.arange(width) - column) / f_px
    alpha_per_m = geometric_extinction(population(settings["kind"], settings["rate_mm_per_h"]))
    path_m = (settings["depth_m"] - settings["near_m"]) * np.sqrt(1 + x**2 + y**2)
    return float(-np.expm1(-alpha_per_m * path_m).mean())


def measure(settings: dict[str, Any], n_seeds: int) -> dict[str, Any]:
    """One block: every seed's statistics, their mean and standard deviation, and the wall time."""
    start = time.perf_counter()
    seeds: list[dict[str, float]] = []
    for seed in range(n_seeds):
        frame = render_counted(**settings, seed=seed)
        counts = {"seed": seed, "n_drawn": frame.n_drawn, "n_in_frame": frame.n_in_frame}
        seeds.append({**counts, **statistics(frame.mask)})
    names = [name for name in seeds[0] if name != "seed"]
    columns = {name: np.array([row[name] for row in seeds]) for name in names}
    alpha_per_m = geometric_extinction(population(settings["kind"], settings["rate_mm_per_h"]))
    return {
        "settings": settings,
        "geometric_extinction_per_m": alpha_per_m,
        "expected_mean": expected_mean(settings),
        "mean_over_seeds": {name: float(values.mean()) for name, values in columns.items()},
        "std_over_seeds": {name: float(values.std(ddof=1)) for name, values in columns.items()},
        "seeds": seeds,
        "run_time_s": round(time.perf_counter() - start, 1),
    }


def main() -> None:
    result: dict[str, Any] = {
        "about": "Coverage masks of tests/reference/every_particle.py: every particle drawn, pinhole camera, fall "
        "straight down the image, constant scene depth. Made by tests/reference/make_particle_statistics.py. "
        "Statistics as defined in every_particle.statistics; n_in_frame counts particles whose centre is inside.",
        "versions": {"python": platform.python_version(), "numpy": np.__version__},
        "blocks": {},
    }
    for name, settings in BLOCKS.items():
        result["blocks"][name] = measure(settings, N_SEEDS[name])
        half_written = TARGET.with_suffix(".tmp")
        half_written.write_text(json.dumps(result, indent=1) + "\n")
        half_written.replace(TARGET)
        print(f"{name}: {result['blocks'][name]['run_time_s']} s", flush=True)


if __name__ == "__main__":
    main()
