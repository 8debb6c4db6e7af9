"""The page of a report: cards, sections with one figure per run, and what a capture has nothing of. Strings only."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from netlab.report import palette

_OPTION = re.compile(r"--[a-z-]+")


@dataclass(frozen=True, slots=True)
class Html:
    """Text that is HTML already."""

    text: str


@dataclass(frozen=True, slots=True)
class Card:
    """One figure at the top; ``is_good`` None is no judgement."""

    name: str
    value: str
    is_good: bool | None = None


@dataclass(frozen=True, slots=True)
class Pane:
    """A plot (SVG) or a table (HTML) with its caption; ``body`` None says why there is none in ``caption``.

    ``label`` names its run where there are two.
    """

    body: str | None
    caption: str = ""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, the panes of the runs side by side, and a caption of them all. ``anchor`` is its name in links.

    ``short`` is the title in the list of sections, if it has another one there.
    """

    anchor: str
    title: str
    panes: Sequence[Pane]
    caption: str = ""
    short: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether no pane shows anything."""
        return all(pane.body is None for pane in self.panes)


def page(title: str, facts: Html, cards: Sequence[Card], sections: Sequence[Section], *, is_pair: bool) -> str:
    """Return the whole page, which needs nothing else: no script, no font, no network."""
    shown = [section for section in sections if not section.is_empty]
    links = "".join(f'<li><a href="#{s.anchor}">{escape(s.short or s.title)}</a></li>' for s in shown)
    style = palette.style() + files("netlab.report").joinpath("page.css").read_text(encoding="utf-8")
    style += palette.print_style()
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width,initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style></head>\n"
        f'<body class="{"two" if is_pair else "one"}"><header><h1>{escape(title)}</h1>{facts.text}\n'
        f'<div class="cards">{"".join(map(_card, cards))}</div></header>\n'
        f'<nav aria-label="Sections"><div class="wide"><ul>{links}</ul></div></nav>\n'
        f"<main>{''.join(map(_section, shown))}{_missing([s for s in sections if s.is_empty])}\n"
        "<footer>Times are scenario seconds: 0 is when every process was ready.</footer></main></body></html>\n"
    )


def figure(svg: str) -> str:
    """A plot that scrolls by itself where the screen is too narrow for it."""
    return f'<div class="figure scroll">{svg}</div>'


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str | Html]],
    *,
    text_columns: Sequence[int] = (0,),
    wrapped_columns: Sequence[int] = (),
) -> str:
    """Return a table; ``text_columns`` stand at the left, the others, numbers, at the right, and only text wraps."""
    kinds = [
        'class="text wrap"' if column in wrapped_columns else 'class="text"' if column in text_columns else ""
        for column in range(len(head))
    ]
    top = "".join(f"<th {kind}>{escape(name)}</th>" for kind, name in zip(kinds, head, strict=True))
    body = "".join(f"<tr>{_cells(row, kinds)}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _cells(row: Sequence[str | Html], kinds: Sequence[str]) -> str:
    texts = (cell.text if isinstance(cell, Html) else escape(cell) for cell in row)
    return "".join(f"<td {kind}>{text}</td>" for kind, text in zip(kinds, texts, strict=True))


def _missing(sections: Sequence[Section]) -> str:
    """What there is nothing of, in one place; links to it lead here."""
    lines = "".join(
        f'<li id="{section.anchor}"><b>{escape(section.short or section.title)}</b>: '
        f"{escape(' '.join(dict.fromkeys(pane.caption for pane in section.panes)))}</li>"
        for section in sections
    )
    return f'\n<section class="missing"><h2>Not in this capture</h2><ul>{lines}</ul></section>' if lines else ""


def _card(card: Card) -> str:
    kind = "" if card.is_good is None else " good" if card.is_good else " bad"
    value, name = escape(card.value), escape(card.name)
    return f'<div class="card{kind}"><span class="value">{value}</span><span class="name">{name}</span></div>'


def _section(section: Section) -> str:
    is_pair = len(section.panes) > 1
    panes = "".join(f"<figure>{_pane(pane)}</figure>" for pane in section.panes)
    kind = ' class="long"' if any(pane.body and "<table" in pane.body for pane in section.panes) else ""
    caption = f"<p>{_prose(section.caption)}</p>" if section.caption and not section.is_empty else ""
    return (
        f'\n<section id="{section.anchor}"{kind}><h2>{escape(section.title)}</h2>'
        f'<div class="panes{" pair" if is_pair else ""}">{panes}</div>{caption}</section>'
    )


def _prose(text: str) -> str:
    """Text in which no line ends inside the name of an option."""
    return _OPTION.sub(r'<span class="option">\g<0></span>', escape(text))


def _pane(pane: Pane) -> str:
    label = f'<div class="label">{escape(pane.label)}</div>' if pane.label else ""
    if pane.body is None:
        return f'{label}<p class="missing">{escape(pane.caption)}</p>'
    caption = f"<figcaption>{_prose(pane.caption)}</figcaption>" if pane.caption else ""
    return f"{label}{pane.body}{caption}"
