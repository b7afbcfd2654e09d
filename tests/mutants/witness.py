"""Pytest plugin of a run on a copy: what was imported from where, and how each test ended, as JSON."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

TO = "TORCHWEATHER_MUTANT_WITNESS"

_ends: list[dict[str, object]] = []


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.when == "call" or not report.passed:
        error = call.excinfo.typename if call.excinfo else ""
        _ends.append(
            {"node": item.nodeid, "when": report.when, "outcome": report.outcome, "error": error, "s": report.duration}
        )
    return report


def pytest_sessionfinish() -> None:
    modules = {
        name: getattr(module, "__file__", None)
        for name, module in sys.modules.items()
        if name == "torchweather" or name.startswith("torchweather.")
    }
    Path(os.environ[TO]).write_text(json.dumps({"modules": modules, "ends": _ends}), encoding="utf-8")
