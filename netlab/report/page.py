"""The page of a report: sections, captions, and what a capture has nothing of."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from netlab.report import palette

_STYLE = """
body{background:var(--page);color:var(--ink);font:15px/1.45 system-ui,sans-serif;
max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem}h2{font-size:1.1rem;margin:2rem 0 .3rem}
p{margin:.3rem 0}.missing{opacity:.75;font-style:italic}
svg{width:100%;height:auto}svg text{font-family:inherit!important}
table{border-collapse:collapse;font-size:.9rem}
th,td{padding:.15rem .6rem;text-align:right;border-bottom:1px solid var(--faint)}
th:first-child,td:first-child{text-align:left}
"""


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and either a plot (SVG) or a table (HTML) with its caption; ``body`` None says why in ``caption``."""

    title: str
    caption: str
    body: str | None


def page(title: str, facts: str, sections: list[Section]) -> str:
    """Return the whole page, which needs nothing else: no script, no font, no network."""
    parts = "\n".join(_section(section) for section in sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width,initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{palette.style()}{_STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1><p>{escape(facts)}</p>\n{parts}\n</body></html>\n"
    )


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table of text."""
    cells = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    return f"<table><tr>{''.join(f'<th>{escape(name)}</th>' for name in head)}</tr>{body}</table>"


def _section(section: Section) -> str:
    if section.body is None:
        return f'<h2>{escape(section.title)}</h2><p class="missing">{escape(section.caption)}</p>'
    return f"<section><h2>{escape(section.title)}</h2>{section.body}<p>{escape(section.caption)}</p></section>"
