"""Rows of text as a table."""

from __future__ import annotations

import re
from collections.abc import Sequence


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of text as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def wrap_markdown(text: str, width: int = 125, most: int = 140) -> str:
    """Markdown with paragraphs and list items wrapped that have a line longer than `most`; the rest stays as it is.

    Tables, headings and code are left alone, and code spans are not broken.
    """
    lines, fenced, out = text.split("\n"), False, []
    k = 0
    while k < len(lines):
        line = lines[k]
        fenced ^= line.lstrip().startswith("```")
        if fenced or not _is_text(line):
            out.append(line)
            k += 1
            continue
        stop = k + 1
        while stop < len(lines) and _is_text(lines[stop]) and not _ITEM.match(lines[stop]):
            stop += 1
        part = lines[k:stop]
        out += _wrapped(part, width) if max(map(len, part)) > most else part
        k = stop
    return "\n".join(out)


_ITEM = re.compile(r"\s*(\*|-|\d+\.) ")
_WORD = re.compile(r"(?:`[^`]*`|[^\s`])+")


def _is_text(line: str) -> bool:
    """Whether a line of Markdown is part of a paragraph or an item."""
    return bool(line.strip()) and not line.startswith(("|", "#", "    ", "```", "<"))


def _wrapped(part: list[str], width: int) -> list[str]:
    """The lines of a paragraph or an item, each as long as fits."""
    item = _ITEM.match(part[0])
    first = item[0] if item else ""
    indent = " " * len(first)
    lines, line = [], first
    for word in _WORD.findall(" ".join([part[0][len(first) :], *part[1:]])):
        if len(line) + len(word) + 1 > width and line.strip():
            lines.append(line.rstrip())
            line = indent
        line += word if line in (first, indent) else f" {word}"
    return [*lines, line.rstrip()]
