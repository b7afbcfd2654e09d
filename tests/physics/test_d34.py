"""D3.4's Table 13, as published and corrected."""

from __future__ import annotations

from functools import cache

import pytest

from tests.oracles import load
from torchweather.physics import Table13Row, table13
from torchweather.physics.d34 import COLOURS_NM, PRINTED_PER_M

KEYS = [(visibility_m, colour) for visibility_m in PRINTED_PER_M for colour in COLOURS_NM]
LETTER = {"blue": "B", "green": "G", "red": "R"}


@cache
def rows() -> dict[tuple[int, str], Table13Row]:
    return {(row.visibility_m, row.colour): row for row in table13()}


@pytest.mark.parametrize("key", KEYS, ids=str)
def test_published_column_is_reproduced_to_every_printed_digit_but_one_misprint(key: tuple[int, str]) -> None:
    row = rows()[key]
    if key == (10, "red"):
        assert f"{row.printed:.4f}" == "0.2989"
        assert f"{row.as_published:.4f}" == "0.2979"
    else:
        assert f"{row.as_published:.4f}" == f"{row.printed:.4f}"


@pytest.mark.parametrize("visibility", load("fog_table5")["rows"])
@pytest.mark.parametrize("colour", LETTER)
def test_published_and_corrected_columns_agree_with_the_oracle(visibility: str, colour: str) -> None:
    oracle = load("fog_table5")["rows"][visibility]["extinction_1_per_m"][LETTER[colour]]
    row = rows()[int(visibility), colour]
    assert row.printed == oracle["table13"]
    assert row.as_published == pytest.approx(oracle["as_published_halfx"], rel=1e-6)  # k of water ends in digit 8
    assert row.corrected == pytest.approx(oracle["full"], rel=5e-4)


def test_colours_spread_by_two_percent_and_not_by_five() -> None:
    blue, red = rows()[50, "blue"], rows()[50, "red"]
    assert red.corrected / blue.corrected - 1.0 == pytest.approx(0.024, abs=0.002)
    assert red.as_published / blue.as_published - 1.0 == pytest.approx(0.05, abs=0.002)


def test_rows_are_four_fogs_by_three_colours_with_koschmieders_value() -> None:
    assert len(rows()) == 12
    assert rows()[50, "red"].koschmieder == pytest.approx(2.995732273553991 / 50.0)
