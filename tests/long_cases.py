"""Cases that cost many seconds beside cheaper ones of the same test: `-m long` runs them, a plain run does not.

    python -m pytest -n 0 -p tests.long_cases --case-times times.json    # processor seconds of every case
    python -m tests.long_cases times.json                                # choose anew, write long_cases.txt

Every test keeps its cheapest case, of a table of recorded scores every few rows. A test that a
deliberate break names (``tests/mutants``) keeps all.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

LIST = Path(__file__).with_name("long_cases.txt")
WORTH_S = 0.2  # processor seconds from which on a case is left to `-m long`
MOST_KEPT_S = 0.4  # of one test: cases are kept, cheapest first, up to this sum

# Rows of one table of recorded scores, of 0.05 s each: every second, third, ... row, about this sum.
TABLES = ("tests/metrics/", "tests/reference/test_naive_image_scores.py::test_score_is_that_of_the_paper")
MOST_OF_A_TABLE_S = 1.2

KEPT_WHOLE = ("tests/behaviour/", "tests/test_docs", "tests/test_examples")  # each case is a test of its own


def listed() -> frozenset[str]:
    """Node ids of the list."""
    return frozenset(LIST.read_text(encoding="utf-8").splitlines())


def chosen(seconds: dict[str, float], named: frozenset[str]) -> list[str]:
    """Node ids that are left to `-m long`.

    Args:
        seconds: node id to processor seconds.
        named: tests that keep all cases.
    """
    cases: dict[str, list[tuple[float, str]]] = defaultdict(list)
    for node, cost in seconds.items():
        test, bracket, _ = node.partition("[")
        if bracket and "::" in test and test not in named and not test.startswith(KEPT_WHOLE):
            cases[test].append((cost, node))
    left_out = []
    for test, some in cases.items():
        if test.startswith(TABLES) and ("::test_oracle" in test or test in TABLES):
            each = math.ceil(sum(cost for cost, _ in some) / MOST_OF_A_TABLE_S)
            left_out += [node for number, (_, node) in enumerate(some) if number % each]
            continue
        kept_s = 0.0
        for number, (cost, node) in enumerate(sorted(some)):
            fits = number == 0 or cost < WORTH_S or kept_s + cost <= MOST_KEPT_S
            if fits:
                kept_s += cost
            else:
                left_out.append(node)
    return sorted(left_out)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the times go."""
    parser.addoption("--case-times", type=Path, default=None, help="JSON of processor seconds, a file for each worker")


class _Times:
    def __init__(self, file: Path) -> None:
        self.file = file
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[object]:
        """Processor seconds of one case and of the processes that it starts."""
        before = _used_s()
        found = yield
        self.seconds[item.nodeid] = round(_used_s() - before, 3)
        return found

    def pytest_sessionfinish(self) -> None:
        """Write what was measured."""
        self.file.write_text(json.dumps(self.seconds), encoding="utf-8")


def _used_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def pytest_configure(config: pytest.Config) -> None:
    """Measure where it is asked for."""
    file = config.getoption("--case-times", default=None)
    if file is not None:
        worker = os.environ.get("PYTEST_XDIST_WORKER", "")
        config.pluginmanager.register(_Times(file.with_name(f"{file.stem}{worker}{file.suffix}")))


def main() -> None:
    """Choose anew from files of times."""
    from tests.mutants.rooms import ROOMS

    seconds: dict[str, float] = {}
    for name in sys.argv[1:]:
        seconds |= json.loads(Path(name).read_text(encoding="utf-8"))
    named = frozenset(node.partition("[")[0] for room in ROOMS.values() for mutant in room for node in mutant.tests)
    nodes = chosen(seconds, named)
    LIST.write_text("".join(f"{node}\n" for node in nodes), encoding="utf-8")
    saved = sum(seconds[node] for node in nodes)
    print(f"{len(nodes)} of {len(seconds)} cases, {saved:.0f} of {sum(seconds.values()):.0f} processor seconds")


if __name__ == "__main__":
    main()
