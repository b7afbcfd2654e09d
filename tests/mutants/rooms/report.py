"""Breaks of the pages."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

PAGE = "torchweather.report.page"

MUTANTS = (
    Mutant(
        "an_end_of_the_search_printed_as_an_interval",
        "an interval is open where it reaches an end of the search",
        "torchweather.report.gap_words",
        "opens = [_same(low, declared.low), _same(high, declared.high)]",
        "opens = [False, False]",
        ("tests/report/test_gap_page.py::test_an_end_of_the_search_is_no_end_of_an_interval",),
    ),
    Mutant(
        "points_on_the_ground_counted_as_below",
        "particles under the ground are counted below the plane",
        "torchweather.report.view_flat",
        "WITHIN_M, UNDER_M = 40.0, 0.3",
        "WITHIN_M, UNDER_M = 40.0, -1.0",
        ("tests/report/test_lidar_flat_figures.py::test_points_under_the_ground_are_those_counted_one_by_one",),
    ),
    Mutant(
        "html_not_escaped",
        "names from a study are escaped in a page",
        PAGE,
        "autoescape=True",
        "autoescape=False",
        ("tests/report/test_cloud_view.py::test_names_and_notes_are_text_and_not_markup",),
    ),
    Mutant(
        "missing_value_left_blank",
        "a value that a page lacks is an error",
        PAGE,
        "undefined=jinja2.StrictUndefined",
        "undefined=jinja2.Undefined",
        ("tests/report/test_page.py::test_a_missing_value_is_an_error",),
    ),
    Mutant(
        "figure_without_words",
        "a figure without a text for those who do not see it is refused",
        "torchweather.report.parts",
        "if not self.alt:",
        "if self.alt is None:",
        ("tests/report/test_page.py::test_a_figure_without_words_for_it_is_refused",),
    ),
    Mutant(
        "link_not_quoted",
        "a file's name in a link is quoted",
        "torchweather.report.parts",
        'target if target.startswith("#") else quote(target)',
        "target",
        ("tests/report/test_page.py::test_markup_stays_and_what_is_filled_in_does_not",),
    ),
    Mutant(
        "markup_not_escaped",
        "values that are filled into markup are escaped",
        "torchweather.report.parts",
        "return Markup(text).format(*values, **named)",
        "return Markup(text.format(*values, **named))",
        ("tests/report/test_page.py::test_markup_stays_and_what_is_filled_in_does_not",),
    ),
)
