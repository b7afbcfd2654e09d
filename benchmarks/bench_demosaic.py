"""Time of the demosaicing of one camera frame, against one elementwise pass over the same array.

    python benchmarks/bench_demosaic.py --out benchmarks/demosaic.json

The yardstick is ``torch.exp(x, out=y)`` of the same array in the same run. Times with ``out=`` reuse their result;
fresh results pay for the page faults of new memory too.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import torch

from torchweather.image import demosaic

HEIGHT, WIDTH = 1464, 1936  # Sony IMX429, the sensor of the Lucid Triton TRI028S


def median_ms(call: Callable[[], object], repeats: int) -> float:
    for _ in range(3):
        call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return statistics.median(times) * 1e3


def cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="JSON file to write; without it the JSON is printed")
    parser.add_argument("--repeats", type=int, default=30)
    arguments = parser.parse_args()

    frame = torch.rand(1, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(0))
    buffer, rgb = torch.empty_like(frame), torch.empty(3, HEIGHT, WIDTH)
    repeats = arguments.repeats
    in_place = median_ms(lambda: torch.exp(frame, out=buffer), 5 * repeats)
    times = {
        "exp_in_place_ms": in_place,
        "exp_fresh_ms": median_ms(lambda: torch.exp(frame), repeats),
        "malvar_out_ms": median_ms(lambda: demosaic(frame, "RGGB", out=rgb), repeats),
        "malvar_rccb_out_ms": median_ms(lambda: demosaic(frame, "RCCB", out=rgb), repeats),
        "malvar_fresh_ms": median_ms(lambda: demosaic(frame, "RGGB"), repeats),
        "bilinear_kornia_ms": median_ms(lambda: demosaic(frame, "RGGB", "bilinear"), max(3, repeats // 5)),
    }
    result = {
        "what": f"demosaic {WIDTH} x {HEIGHT} float32",
        "machine": {"cpu": cpu_name(), "threads": torch.get_num_threads(), "torch": torch.__version__},
        "times": {name: round(value, 3) for name, value in times.items()},
        "malvar_out_over_exp_in_place": round(times["malvar_out_ms"] / in_place, 2),
        "target_at_most": 40,
    }
    text = json.dumps(result, indent=2)
    if arguments.out is None:
        print(text)
    else:
        arguments.out.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
