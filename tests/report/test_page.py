"""A template without one of its values is an error, not a page with a hole."""

from __future__ import annotations

import jinja2
import pytest

from torchweather.report.page import html_page


def test_a_missing_value_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError):
        html_page("study_findings.html")
