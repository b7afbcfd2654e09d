"""The record of behaviour: what every case answered when the record was written.

python -m tests.behaviour.record --check     # compare, name by name
python -m tests.behaviour.record --write     # after a change of behaviour that is meant
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tests.behaviour.cases import cases
from tests.behaviour.digest import agree, exact, numbers

os.environ["TORCHWEATHER_COMPILED"] = "0"  # the record is of torch's path

RECORD = Path(__file__).with_name("record.json")
# Rounding of other processors; an optimiser's steps grow it.
RTOL, RTOL_OF = 1e-5, {"studies": 0.02, "graphs": 1e-4, "scores": 1e-4}


def machine() -> str:
    """Everything that the last bits of a result depend on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
    except OSError:
        processor = platform.processor()
    capability = torch.backends.cpu.get_cpu_capability()
    threads = os.environ.get("OPENBLAS_NUM_THREADS") or os.environ.get("OMP_NUM_THREADS") or "all"
    versions = f"torch {torch.__version__}, numpy {np.__version__}"
    return f"{processor}, {capability}, {threads} threads of linear algebra, {versions}"


def answered(name: str) -> dict[str, Any]:
    """Hash and numbers of one case."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.no_grad():
            value = cases()[name]()
    finally:
        torch.set_num_threads(threads)
    return {"hash": exact(value), "numbers": [float(f"{number:.9g}") for number in numbers(value)]}


def differs(name: str, found: dict[str, Any], recorded: dict[str, Any], same_machine: bool) -> bool:
    """Whether a case answers otherwise than it did: to the last bit on the same machine, to rounding on another."""
    if found["hash"] == recorded["hash"]:
        return False
    if same_machine:
        return True
    return not agree(found["numbers"], recorded["numbers"], RTOL_OF.get(name.split("/", 1)[0], RTOL))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--check", action="store_true")
    action.add_argument("--write", action="store_true")
    parser.add_argument("--only", default="", help="cases whose names start so")
    arguments = parser.parse_args()
    found, seconds = {}, {}
    for name in cases():
        if name.startswith(arguments.only):
            started = time.perf_counter()
            found[name] = answered(name)
            seconds[name] = time.perf_counter() - started
    slowest = sorted(seconds, key=lambda name: -seconds[name])[:8]
    print(f"{len(found)} cases, {sum(seconds.values()):.1f} s; " + ", ".join(f"{n} {seconds[n]:.1f}" for n in slowest))
    if arguments.write:
        text = json.dumps({"machine": machine(), "cases": found}, indent=1)
        RECORD.write_text(text.replace("[\n    ", "[").replace(",\n    ", ", ").replace("\n   ]", "]") + "\n")
        return 0
    recorded = json.loads(RECORD.read_text(encoding="utf-8"))
    same = recorded["machine"] == machine()
    wrong = [n for n in found if n not in recorded["cases"] or differs(n, found[n], recorded["cases"][n], same)]
    gone = [name for name in recorded["cases"] if name.startswith(arguments.only) and name not in found]
    print(*(f"differs: {name}" for name in wrong), *(f"gone: {name}" for name in gone), sep="\n")
    return int(bool(wrong or gone))


if __name__ == "__main__":
    sys.exit(main())
