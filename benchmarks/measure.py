"""What every benchmark needs: times of a call, and the machine they were taken on."""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from torchweather.io import atomic_write

__all__ = ["commit", "cpu_times_ms", "hand_over", "machine", "spread", "times_ms"]


def times_ms(call: Callable[[], object], repeats: int) -> dict[str, float]:
    """Median, least and greatest of a call's times after two calls that do not count."""
    for _ in range(2):
        call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - start))
    return spread(times)


def cpu_times_ms(calls: dict[str, Callable[[int], object]], repeats: int) -> dict[str, list[float]]:
    """Processor times of calls by seed, all in turn, so that a slow minute of the machine hits all; after two rounds
    that do not count."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for seed in range(repeats + 2):
        for name, call in calls.items():
            start = time.process_time()
            call(seed)
            if seed >= 2:
                times[name].append(1e3 * (time.process_time() - start))
    return times


def spread(times: list[float]) -> dict[str, float]:
    """Median, least and greatest of times in milliseconds."""
    return {
        "median_ms": round(statistics.median(times), 3),
        "min_ms": round(min(times), 3),
        "max_ms": round(max(times), 3),
        "repeats": len(times),
    }


def cpu_name() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def commit() -> str | None:
    """Commit of the code that is measured, with ``+ changes`` where files differ from it; ``None`` outside a clone."""
    git = ["git", "-C", str(Path(__file__).parent)]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        status = [*git, "status", "--porcelain", "--untracked-files=no"]
        changed = subprocess.run(status, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{head} + changes" if changed else head


def machine() -> dict[str, Any]:
    """What the figures belong to: the code's commit and the machine."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "commit": commit(),
        "cpu": cpu_name(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "torch": torch.__version__,
        "load_at_start": load,
    }


def hand_over(result: dict[str, Any], out: Path | None) -> None:
    """Write a result as JSON to a file, or print it."""
    text = json.dumps(result, indent=2) + "\n"
    if out is None:
        print(text, end="")
        return
    with atomic_write(out) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
