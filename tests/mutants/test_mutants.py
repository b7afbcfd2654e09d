"""The list of deliberate breaks: it does not rot, its runner judges rightly, and every break goes red."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest

from tests.mutants.mutant import ROOT, Mutant, missing_test
from tests.mutants.rooms import ROOMS
from tests.mutants.run import RED, run_mutants

EVERY = [mutant for mutants in ROOMS.values() for mutant in mutants]
LEAST = 75


def test_the_list_is_long_and_its_names_are_unique() -> None:
    assert len(EVERY) >= LEAST
    assert all(ROOMS.values())
    assert max(Counter(mutant.name for mutant in EVERY).values()) == 1


@pytest.mark.parametrize("mutant", EVERY, ids=lambda mutant: mutant.name)
def test_text_of_a_mutant_stands_in_its_module_and_its_tests_exist(mutant: Mutant) -> None:
    """A moved or reworded line of the package, or a renamed test, needs its line in the table changed."""
    source = mutant.mutated()
    assert source != mutant.file().read_text(encoding="utf-8")
    compile(source, mutant.file(), "exec")
    assert mutant.tests
    assert [missing for node in mutant.tests if (missing := missing_test(node))] == []


def test_a_text_that_stands_twice_or_not_at_all_is_refused() -> None:
    for old in ("no such text", "return"):
        with pytest.raises(LookupError, match="expected its text once"):
            replace(EVERY[0], old=old).mutated()


@pytest.mark.parametrize(
    ("node", "said"),
    [
        ("tests/no_such_file.py::test_x", "no file"),
        ("tests/mutants/test_mutants.py::test_no_such", "no test_no_such"),
        ("tests/mutants/test_mutants.py", "names no test function"),
        ("tests/mutants/test_mutants.py::test_the_list_is_long_and_its_names_are_unique", None),
        ("tests/mutants/test_mutants.py::test_every_mutant_goes_red[io]", None),
    ],
)
def test_a_missing_test_is_named(node: str, said: str | None) -> None:
    found = missing_test(node)
    assert (said is None and found is None) or (said is not None and found is not None and said in found)


@pytest.mark.long  # seconds
def test_survivors_slips_and_red_tests_are_told_apart() -> None:
    """The working tree stays as it is; a test that fails of a slip in the mutant is not red."""
    red = Mutant(
        "red",
        "a constant of Koschmieder's law",
        "torchweather.physics.visibility",
        "MOR_CONTRAST = 0.05",
        "MOR_CONTRAST = 0.02",
        ("tests/physics/test_visibility.py::test_koschmieder_constants",),
    )
    file = red.file(ROOT)
    before = file.read_bytes()
    slip = replace(red, name="slip", new="MOR_CONTRAST = no_such_name")
    survivor = replace(red, name="survivor", new="MOR_CONTRAST = 0.050")
    gone = replace(red, name="gone", old="no such text")
    ends = {outcome.name: outcome for outcome in run_mutants([red, slip, survivor, gone])}
    assert file.read_bytes() == before
    assert [name for name, outcome in ends.items() if outcome.good] == ["(no break)", "red"]
    assert ends["red"].end.startswith(RED)
    assert ends["survivor"].end == "survived"
    assert "expected its text once" in ends["gone"].end
    missing = run_mutants([replace(red, tests=("tests/physics/test_visibility.py::test_gone",))])
    assert [outcome.good for outcome in missing] == [False]


@pytest.mark.long  # minutes
@pytest.mark.parametrize("room", ROOMS)
def test_every_mutant_goes_red(room: str) -> None:
    assert [outcome for outcome in run_mutants(ROOMS[room]) if not outcome.good] == []
