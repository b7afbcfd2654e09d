"""Findings about a study: the section of a page, and the warnings beside its verdict."""

from __future__ import annotations

from collections.abc import Sequence

from torchweather.gap.diagnosis import Finding
from torchweather.report import parts
from torchweather.report.report import Section

__all__ = ["study_alerts", "study_section"]


def study_alerts(findings: Sequence[Finding]) -> list[parts.Alert]:
    """Warnings for the head of the page: findings that put the verdict in doubt."""
    bold = "The study cannot be trusted."
    return [parts.Alert(f"{each.what} {each.cost} {each.advice}", bold) for each in findings if each.level == "error"]


def study_section(findings: Sequence[Finding]) -> Section:
    """All findings in a table."""
    words = (parts.Column(title, "words") for title in ("What", "What it costs", "What to do"))
    rows = [(each.level, each.what, each.cost, each.advice) for each in findings]
    table = (
        parts.Table(["Level", *words], rows, look="tops") if rows else parts.Paragraph("Nothing stands against them.")
    )
    return Section("The data of the study", [table], id="study")
