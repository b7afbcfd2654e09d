"""The language of the pages, as far as it can be counted: length of sentences, and phrases that read as a translation.

A page that is still above a bar is listed with its figures. They may only fall. A page that meets the bars leaves
the list.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
README_WORDS = 700
AVERAGE_WORDS = 20.0
LONGEST_WORDS = 45
PHRASES = re.compile(
    r"held against|\bwhat is left\b(?! out)|\ba rest\b|in square\b|told from|\bby how much more\b", re.IGNORECASE
)

FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
ITEM = re.compile(r"(?:[-*+]|\d+\.)\s+(.*)")
END = re.compile(r"(?<=[.!?])['\")]*\s+(?=[A-Z0-9\"(−])")


class Language(NamedTuple):
    """Figures of a page: words a sentence, words of the longest one, phrases to avoid."""

    average: float
    longest: int
    phrases: int


BARS = Language(AVERAGE_WORDS, LONGEST_WORDS, 0)
STILL_ABOVE: dict[str, Language] = {
    "docs/PHYSICS.md": Language(19.5, 101, 0),  # the audited table of equations
}


def paragraphs(text: str) -> list[str]:
    """Paragraphs and items of a page; no code, tables, headings or quoted licences."""
    found, current = [], []
    for line in [*LINK.sub(r"\1", FENCE.sub("", text)).splitlines(), ""]:
        stripped = line.strip()
        item = ITEM.match(stripped)
        if not stripped or stripped.startswith(("|", "#", ">")) or item:
            if current:
                found.append(" ".join(current))
            current = [item[1]] if item else []
        else:
            current.append(stripped)
    return found


def sentences(text: str) -> list[str]:
    """Sentences of a page; a piece of code in a line is one word, and a list of names is no sentence."""
    listed = []
    for paragraph in paragraphs(text):
        plain = re.sub(r"`[^`]*`", "Code", paragraph).replace("*", "")
        listed += [
            sentence for sentence in END.split(plain) if set(sentence.split()) > {"Code"} or "Code" not in sentence
        ]
    return [sentence for sentence in listed if words(sentence)]


def words(sentence: str) -> int:
    return sum(1 for word in sentence.split() if re.search(r"\w", word))


def language_of(text: str) -> Language:
    found = sentences(text)
    counts = [words(sentence) for sentence in found]
    phrases = sum(len(PHRASES.findall(sentence)) for sentence in found)
    return Language(round(sum(counts) / max(len(counts), 1), 1), max(counts, default=0), phrases)


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_sentences_of_a_page_are_short_and_plain(page: Path) -> None:
    found = language_of(page.read_text(encoding="utf-8"))
    allowed = STILL_ABOVE.get(name_of(page), BARS)
    most = Language(*(max(pair) for pair in zip(BARS, allowed, strict=True)))
    assert all(figure <= bar for figure, bar in zip(found, most, strict=True)), f"{found}; at most {most}"


@pytest.mark.parametrize("page", STILL_ABOVE)
def test_a_page_that_meets_the_bars_leaves_the_list(page: str) -> None:
    found = language_of((ROOT / page).read_text(encoding="utf-8"))
    assert any(figure > bar for figure, bar in zip(found, BARS, strict=True)), f"{page} meets the bars: take it off"


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= README_WORDS


def test_sentences_are_counted_as_a_reader_would() -> None:
    text = """# Not counted here

One two three. `code with words` five
six [seven eight](a/b.md)!

| not | counted |

- Nine ten
- `a` `b`

```python
not = counted
```
"""
    assert [words(sentence) for sentence in sentences(text)] == [3, 5, 2]
    assert language_of("It is held against a rest.\n") == Language(6.0, 6, 2)
