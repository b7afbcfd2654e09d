"""The list of cases that are left to `-m long`: it leaves no test without a case, and names tests that exist."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.long_cases import chosen, listed
from tests.mutants.rooms import ROOMS

ROOT = Path(__file__).parents[1]


def test_every_test_keeps_its_cheapest_case_and_named_ones_keep_all() -> None:
    seconds = {
        "tests/a.py::one[x]": 9.0,
        "tests/a.py::one[y]": 5.0,
        "tests/a.py::one[z]": 8.0,
        "tests/a.py::two[x]": 0.1,
        "tests/a.py::two[y]": 1.5,
        "tests/a.py::two[z]": 0.25,
        "tests/a.py::two[w]": 1.6,
        "tests/a.py::named[x]": 7.0,
        "tests/a.py::named[y]": 7.0,
        "tests/a.py::alone": 30.0,
        "tests/behaviour/b.py::each[x]": 9.0,
        "tests/behaviour/b.py::each[y]": 9.0,
    }
    left_out = chosen(seconds, frozenset({"tests/a.py::named"}))
    assert left_out == ["tests/a.py::one[x]", "tests/a.py::one[z]", "tests/a.py::two[w]", "tests/a.py::two[y]"]


def test_every_few_rows_of_a_table_of_scores_are_kept() -> None:
    rows = [f"tests/metrics/test_a.py::test_oracle[{number}]" for number in range(60)]
    left_out = chosen(dict.fromkeys(rows, 0.05), frozenset())  # 3 s together: every third
    assert sorted(set(rows) - set(left_out)) == sorted(rows[::3])
    assert chosen(dict.fromkeys(rows, 0.05), frozenset({"tests/metrics/test_a.py::test_oracle"})) == []


def test_the_list_names_tests_that_exist() -> None:
    functions: dict[str, set[str]] = {}
    for node in listed():
        file, _, name = node.partition("[")[0].partition("::")
        if file not in functions:
            tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            functions[file] = {one.name for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)}
        assert name.rpartition("::")[2] in functions[file], f"{node}: no such test. Choose anew (tests/long_cases.py)."


def test_deliberate_breaks_need_no_case_of_the_list() -> None:
    named = {node.partition("[")[0] for room in ROOMS.values() for mutant in room for node in mutant.tests}
    assert not named & {node.partition("[")[0] for node in listed()}
