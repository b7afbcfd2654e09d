"""Breaks of the validation against recordings, and of the fit to them."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

POWER_TESTS = "tests/evaluation/validation/test_power.py"
COMPARISON = "torchweather.evaluation.validation.comparison"

MUTANTS = (
    Mutant(
        "agreement_without_power",
        "frames that could not have differed do not agree",
        COMPARISON,
        "if factor not in there or self.power(factor) < POWER:",
        "if factor not in there:",
        (f"{POWER_TESTS}::test_agreement_takes_power",),
    ),
    Mutant(
        "power_of_one_side",
        "the scatter of the changed frames counts at their own number",
        COMPARISON,
        "parts = [(deviation / math.sqrt(count) if count else math.nan, count - 1), *own[1:]]",
        "parts = [(deviation / count if count else math.nan, count - 1), *own[1:]]",
        (f"{POWER_TESTS}::test_power_is_the_share_of_drawn_studies_that_differ",),
    ),
)
