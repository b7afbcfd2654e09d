"""The language of pages, docstrings, help and messages, as far as it can be counted: sentences and phrases.

A page that is still above a bar is listed with its figures. They may only fall. A page that meets the bars leaves
the list.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.public_names import documented_members
from tests.sources import walk
from torchweather.cli.program import build_parser

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


FIRST_LINE_WORDS = 25  # of the first sentence of a docstring, and of each sentence of a help text or message
QUESTION = re.compile(r"(?:What|Whether|By how|How|Why|Which)\b", re.IGNORECASE)
SPEAKS = re.compile(r"\b(?:says?|knows?|tells?|wants?)\b")  # what software does not do


def faults(sentence: str) -> list[str]:
    """Rules of the house that a sentence breaks."""
    found = [f"{words(sentence)} words"] if words(sentence) > FIRST_LINE_WORDS else []
    found += ["opens as a question"] if QUESTION.match(sentence) else []
    return found + [match[0] for match in (PHRASES.search(sentence), SPEAKS.search(sentence)) if match]


def test_docstrings_begin_with_a_noun_phrase_or_an_imperative() -> None:
    wrong = {}
    listed = list(documented_members())
    for name, docstring in listed:
        first = END.split(" ".join(docstring.strip().split("\n\n")[0].split()))[0]
        if faults(first):
            wrong[name] = (faults(first), first)
    assert not wrong
    assert len(listed) > 1000


OPENING = re.compile(r'^ *"""(?:What|Whether|By how|How|Why|Which)\b', re.MULTILINE)


def test_no_docstring_opens_as_a_question() -> None:
    found = [path.name for path in (ROOT / "torchweather").rglob("*.py") if OPENING.search(path.read_text("utf-8"))]
    assert not found


def help_texts(parser: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, str]]:
    """Every text of a command line by its place."""
    yield name, parser.description or ""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action._choices_actions:
                yield f"{name} {choice.dest}, summary", choice.help or ""
            for command, inner in action.choices.items():
                yield from help_texts(inner, f"{name} {command}")
        elif action.help and action.help is not argparse.SUPPRESS:
            yield f"{name} {'/'.join(action.option_strings) or action.dest}", action.help


def test_help_of_the_command_line_is_short_and_plain() -> None:
    wrong = {}
    for place, text in help_texts(build_parser(), "torchweather"):
        for sentence in re.split(r"(?<=[.!?;])\s+", " ".join(text.split())):
            if faults(sentence):
                wrong[place] = (faults(sentence), sentence)
    assert not wrong


def text_of(node: ast.AST) -> str:
    """The text of a literal, with one word for each value in it; empty for anything else."""
    if isinstance(node, ast.JoinedStr):
        return "".join(map(text_of, node.values))
    if isinstance(node, ast.FormattedValue):
        return "X"
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        both = text_of(node.left), text_of(node.right)
        return " ".join(text or "X" for text in both) if any(both) else ""
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def texts_of(node: ast.AST) -> Iterator[str]:
    """Texts of an expression, each whole."""
    if text := text_of(node):
        yield text
    else:
        for part in ast.iter_child_nodes(node):
            yield from texts_of(part)


SAYS_SO = ("Error", "Warning", "Exit")  # ends of classes that are raised or given to a warning


def messages(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Texts of errors and warnings by their line, with those between which an expression chooses."""
    for call in walk(tree):
        if isinstance(call, ast.Call):
            name = getattr(call.func, "attr", getattr(call.func, "id", ""))
            if name.endswith(SAYS_SO) or name in ("warn", "error"):
                for argument in call.args:
                    yield from ((call.lineno, text) for text in texts_of(argument) if len(text.split()) > 2)


def test_messages_are_short_and_plain() -> None:
    wrong, counts = [], []
    for path in sorted((ROOT / "torchweather").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        if re.search("|".join((*SAYS_SO, r"warn\(", r"error\(")), source):
            for line, text in messages(ast.parse(source)):
                for sentence in re.split(r"(?<=[.!?;])\s+", " ".join(text.split())):
                    counts.append(words(sentence))
                    wrong += [(path.name, line, faults(sentence), sentence)] if faults(sentence) else []
    assert not wrong
    assert len(counts) > 3000
    assert sum(counts) / len(counts) < AVERAGE_WORDS


def test_messages_are_found_in_a_source() -> None:
    source = """
def check(x, name):
    if x:
        raise TorchweatherError(f"{name}: expected a thing {x}; " "got none.")
    warnings.warn("A wordy text here." + more(x), TorchweatherWarning)
    raise InputValueError("too long a text" if x else f"too short a {x}") from None
"""
    found = sorted(messages(ast.parse(source)))
    assert [line for line, _ in found] == [4, 5, 6, 6]
    assert [text for _, text in found] == [
        "X: expected a thing X; got none.",
        "A wordy text here. X",
        "too long a text",
        "too short a X",
    ]


@pytest.mark.parametrize(
    ("sentence", "fault"),
    [
        ("What the film costs.", "opens as a question"),
        ("The preset says how it is read.", "says"),
        ("Scores held against a floor.", "held against"),
        (" ".join(["word"] * 26), "26 words"),
    ],
)
def test_a_fault_is_seen(sentence: str, fault: str) -> None:
    assert faults(sentence) == [fault]
    assert not faults("Loss of the film, dB.")
