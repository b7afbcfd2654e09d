"""Parts of a page: each is drawn, escaped and well formed; the style holds for dark screens, paper and narrow ones."""

from __future__ import annotations

import inspect
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import jinja2
import pytest

from tests.report.parsed_page import Page
from torchweather.core.errors import TorchweatherError
from torchweather.report import parts
from torchweather.report.page import html_of, write_report
from torchweather.report.report import Report, Section

EVIL = '<b id="x">&\''
PIXEL = "data:image/png;base64,AAAA"
FIGURE = parts.Figure(PIXEL, EVIL, title=EVIL, small=EVIL, caption=EVIL, facts=[EVIL], look="chart")
SLIDER: dict[str, Any] = {"number": 1, "title": EVIL, "before": PIXEL, "size": EVIL, "width": 4, "height": 3}
SAMPLES: dict[str, parts.Part] = {
    "Verdict": parts.Verdict(EVIL),
    "Alert": parts.Alert(EVIL, EVIL, grave=True),
    "Paragraph": parts.Paragraph(EVIL),
    "Note": parts.Note(EVIL),
    "Fine": parts.Fine(EVIL),
    "Prose": parts.Prose([EVIL, parts.markup("<em>{}</em>", EVIL)]),
    "Heading": parts.Heading(EVIL, EVIL),
    "Facts": parts.Facts([(EVIL, EVIL)]),
    "Legend": parts.Legend([parts.Key(EVIL, "#fff"), parts.Key(EVIL, glyph=EVIL)], chart=True),
    "Table": parts.Table(
        [EVIL, parts.Column(EVIL, "words"), "n"],
        [EVIL, (EVIL, parts.Cell(EVIL, [EVIL], data={"key": EVIL}, shade=0.5, bar_px=3), "1")],
        over=[("", 1), (EVIL, 2)],
    ),
    "Figure": FIGURE,
    "Pictures": parts.Pictures([FIGURE, FIGURE]),
    "Listing": parts.Listing([EVIL]),
    "Code": parts.Code(EVIL),
    "Details": parts.Details(EVIL, [parts.Note(EVIL)]),
    "Columns": parts.Columns([(EVIL, [parts.Note(EVIL)]), (EVIL, [])]),
    "Widget": parts.Widget("slider.html", {**SLIDER, "panels": [(EVIL, EVIL, PIXEL)]}),
}


def page_of(*shown: parts.Part, **more: Any) -> str:
    return html_of(Report(EVIL, [parts.Verdict("v")], [Section(EVIL, shown)], **more))


def test_every_part_has_a_sample() -> None:
    kinds = {name for name, one in vars(parts).items() if inspect.isclass(one) and issubclass(one, parts.Part)}
    assert kinds - {"Part"} == set(SAMPLES)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_part_is_well_formed_and_its_text_is_no_markup(name: str) -> None:
    text = page_of(SAMPLES[name])
    page = Page(text)
    assert page.mistakes == []
    assert EVIL not in text
    assert EVIL in page.words
    assert "built-in method" not in text
    assert all(attributes.get("id") != "x" for _, attributes in page.elements)


def test_all_parts_stand_on_one_page_and_each_says_what_it_holds() -> None:
    page = Page(page_of(*SAMPLES.values(), footer=Section("f", [parts.Fine("end")])))
    assert page.mistakes == []
    # Beside the heading and the tab's title: as often as the parts hold it.
    alone = sum(Page(page_of(one)).words.count(EVIL) for one in SAMPLES.values())
    assert page.words.count(EVIL) == alone - 3 * (len(SAMPLES) - 1)


def test_markup_stays_and_what_is_filled_in_does_not() -> None:
    text = page_of(parts.Paragraph(parts.markup("<code>{}</code>", "<i>")))
    assert "<code>&lt;i&gt;</code>" in text
    assert str(parts.link("a b/c?.csv", "<x>")) == '<a href="a%20b/c%3F.csv">&lt;x&gt;</a>'
    assert str(parts.link("#part-1")) == '<a href="#part-1">#part-1</a>'


def test_a_figure_without_words_for_it_is_refused() -> None:
    with pytest.raises(ValueError, match="alt"):
        parts.Figure(PIXEL, "")
    assert [image["alt"] for image in Page(page_of(FIGURE)).all("img")] == [EVIL]


def test_rows_and_columns_of_a_table_are_headings_and_numbers_stand_right() -> None:
    table = parts.Table(["Name", parts.Column("Words", "words"), "Count"], ["Band", ("a", "b", parts.Cell("3"))])
    text = page_of(table)
    page = Page(text)
    assert [head.get("scope") for head in page.all("th")] == ["col"] * 3 + ["colgroup", "row"]
    assert '<td class="words">b</td><td>3</td>' in text
    style = text[text.index("<style>") : text.index("</style>")]
    assert re.search(r":is\(th,td\)\{[^}]*text-align:right", style)
    assert "tabular-nums" in style
    assert [one["aria-label"] for one in page.all("div") if one.get("class") == "scroll"] == ["Name"]


def test_no_level_of_headings_is_left_out() -> None:
    section = Section("two", [FIGURE, parts.Columns([("three", [])])])
    for sections in ([section], [Section("chapter", [FIGURE], id="c", sections=[section, section])]):
        levels = [int(tag[1]) for tag in re.findall(r"<(h[1-6])", html_of(Report("one", [], sections)))]
        assert levels[0] == 1
        assert levels.count(1) == 1
        assert all(after <= before + 1 for before, after in pairwise(levels))


def test_a_chapter_links_to_its_sections() -> None:
    below = [Section("Rain", [], id="rain", short="Rain"), Section("Inputs", [])]
    page = Page(html_of(Report("t", [], [Section("Track", [], sections=below)])))
    assert [link["href"] for link in page.all("a")] == ["#rain"]


def test_the_style_has_rules_for_the_dark_for_paper_and_for_narrow_screens() -> None:
    text = page_of(*SAMPLES.values(), styles=["slider.css", "cloud.css"])
    style = text[text.index("<style>") : text.index("</style>")]
    assert "@media screen and (prefers-color-scheme:dark)" in style  # paper stays light
    assert "@media print" in style
    assert "@media screen and (max-width:560px)" in style
    light, dark = (set(re.findall(r"(--[a-z-]+):", block)) for block in re.findall(r":root\{(.*?)\}", style))
    assert "filter:invert" in style  # of line charts
    assert dark == light - {"--new"}  # every colour but the orange that both have
    used = set(re.findall(r"var\((--[a-z-]+)\)", style))
    assert used - light == {"--c", "--shade", "--at"}  # given where they are used
    assert '<meta name="color-scheme" content="light dark">' in text


def test_a_page_without_tables_or_figures_carries_no_style_for_them() -> None:
    plain, full = page_of(parts.Note("n")), page_of(FIGURE, SAMPLES["Table"])
    assert "table{" not in plain
    assert ".grid{" not in plain
    assert "table{" in full
    assert ".grid{" in full


def test_nothing_comes_from_elsewhere_and_no_script_runs_where_none_is_needed() -> None:
    text = page_of(*SAMPLES.values(), styles=["slider.css", "cloud.css"])
    assert not re.search(r"https?://|url\(|@import|//[a-z]", text)
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:\"" in text
    assert not Page(text).all("script")
    scripted = page_of(scripts=["slider.js"], data={"name": "</script>"})
    assert "script-src 'unsafe-inline'" in scripted
    assert [script.get("type") for script in Page(scripted).all("script")] == ["application/json", None]
    assert Page(scripted).mistakes == []


def test_a_missing_value_is_an_error() -> None:
    values = {name: value for name, value in SLIDER.items() if name != "size"}
    with pytest.raises(jinja2.UndefinedError, match="size"):
        page_of(parts.Widget("slider.html", {**values, "panels": [("fog", "A caption.", PIXEL)]}))


def test_a_page_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text("old")
    with pytest.raises(jinja2.UndefinedError):
        write_report(Report("t", [], [Section("s", [parts.Widget("slider.html", {})])]), path)
    with pytest.raises(TorchweatherError, match="no folder"):
        write_report(Report("t", [], []), tmp_path / "none" / "page.html")
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("page.html", "old")]
    report = Report("t", [], [])
    write_report(report, path)
    assert path.read_text(encoding="utf-8") == html_of(report)
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]
