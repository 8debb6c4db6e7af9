"""The page of a report in a real browser: light and dark, wide, narrow and printed.

``NETLAB_SCREENSHOTS=DIR`` keeps the pictures that are taken.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from netlab.report.build import write_report
from tests.report.conftest import MakeMission
from tests.report.headless_browser import Browser, chromium

pytest.importorskip("matplotlib", reason="the extra `report` is not installed")

SECTIONS = 11
WIDE, NARROW = 1280, 390
# Two pieces of text of one plot that cover each other, as "this / that"; a pixel may touch.
OVERLAPS = """
(() => [...document.querySelectorAll('svg')].flatMap(svg => {
  const texts = [...svg.querySelectorAll('text')].filter(t => t.textContent.trim())
    .map(t => [t.textContent, t.getBoundingClientRect()]);
  return texts.flatMap(([a, p], i) => texts.slice(i + 1)
    .filter(([b, q]) => Math.min(p.right, q.right) - Math.max(p.left, q.left) > 1
      && Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top) > 1)
    .map(([b]) => a + ' / ' + b));
}))()
"""
# Text of a plot that is cut off by the plot's own edge.
CUT = """
(() => [...document.querySelectorAll('svg')].flatMap(svg => {
  const box = svg.getBoundingClientRect();
  return [...svg.querySelectorAll('text')].filter(t => t.textContent.trim()).filter(t => {
    const b = t.getBoundingClientRect();
    return b.left < box.left - 1 || b.right > box.right + 1 || b.top < box.top - 1 || b.bottom > box.bottom + 1;
  }).map(t => t.textContent);
}))()
"""
# What sticks out of the page at the right, unless it scrolls by itself.
OUTSIDE = """
(() => [...document.querySelectorAll('main *, header *')]
  .filter(e => !e.closest('.scroll, pre, svg') || e.matches('.scroll'))
  .filter(e => e.getBoundingClientRect().right > document.documentElement.clientWidth + 1)
  .map(e => e.tagName + '.' + e.className))()
"""
FIGURES = """
(() => [...document.querySelectorAll('svg')].map(s => {
  const b = s.getBoundingClientRect();
  return {width: b.width, height: b.height, drawn: s.querySelectorAll('path, image').length,
          label: s.getAttribute('aria-label')};
}))()
"""
COLOURS = """
(() => { const s = getComputedStyle(document.body), t = getComputedStyle(document.querySelector('svg text'));
  return {ground: s.backgroundColor, ink: s.color, plot: t.fill}; })()
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    program = chromium()
    if program is None:
        pytest.skip(
            "no chromium is installed; nobody has looked at the report. To have it: sudo apt-get install chromium"
        )
    with Browser(program) as running:
        yield running


@pytest.fixture(scope="module")
def single(make_mission: MakeMission, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(make_mission(), tmp_path_factory.mktemp("single"))


@pytest.fixture(scope="module")
def pair(make_mission: MakeMission, tmp_path_factory: pytest.TempPathFactory) -> Path:
    other = make_mission("lossy", loss_ratio=0.25, seed=2)
    return write_report(make_mission(), tmp_path_factory.mktemp("pair"), other=other)


def keep(browser: Browser, name: str) -> None:
    if folder := os.environ.get("NETLAB_SCREENSHOTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        browser.picture(Path(folder) / f"{name}.png")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [WIDE, NARROW], ids=["wide", "narrow"])
@pytest.mark.parametrize("which", ["single", "pair"])
def test_everything_is_there_and_nothing_covers_anything(
    browser: Browser, request: pytest.FixtureRequest, which: str, width: int, dark: bool
) -> None:
    page = request.getfixturevalue(which)
    browser.show(page, width=width, dark=dark)
    keep(browser, f"{which}-{width}-{'dark' if dark else 'light'}")
    assert browser.logged == []
    assert browser.requested == [page.resolve().as_uri()], "nothing but the page itself is asked for"
    assert browser.ask("document.documentElement.scrollWidth") <= width, browser.ask(OUTSIDE)
    assert browser.ask(OUTSIDE) == []
    assert browser.ask(OVERLAPS) == []
    assert browser.ask(CUT) == []
    figures = browser.ask(FIGURES)
    assert len(figures) == (9 if which == "single" else 17)
    assert all(figure["width"] >= 300 and figure["height"] >= 80 for figure in figures), figures
    assert all(figure["drawn"] > 10 and figure["label"] for figure in figures), figures


def brightness(colour: str) -> int:
    """Of ``rgb(r, g, b)``, 0 to 765."""
    return sum(int(part) for part in colour.removeprefix("rgb(").removesuffix(")").split(","))


def test_it_is_light_dark_and_on_paper_always_white(browser: Browser, single: Path) -> None:
    browser.show(single, width=WIDE)
    light = browser.ask(COLOURS)
    browser.colours(dark=True)
    dark = browser.ask(COLOURS)
    browser.colours(dark=True, media="print")
    paper = browser.ask(COLOURS)
    keep(browser, "single-print")
    assert brightness(light["ground"]) > 700 > 200 > brightness(light["ink"])
    assert brightness(dark["ground"]) < 100 < 600 < brightness(dark["ink"])
    assert light["plot"] == light["ink"], "plots follow the page"
    assert dark["plot"] == dark["ink"], "plots follow the page"
    assert paper["ground"] == "rgb(255, 255, 255)"
    assert paper["ink"] == light["ink"]


def test_it_prints_with_every_plot_on_one_sheet(browser: Browser, single: Path, tmp_path: Path) -> None:
    browser.show(single, width=794, dark=True)
    browser.colours(dark=True, media="print")
    heights = browser.ask("[...document.querySelectorAll('section:not(.long)')].map(s => s.offsetHeight)")
    assert max(heights) < 1000, "an A4 sheet has 1017 pixels between its margins"
    assert browser.ask("document.documentElement.scrollWidth") <= 794
    assert browser.ask("getComputedStyle(document.querySelector('nav')).display") == "none"
    browser.pdf(tmp_path / "report.pdf")
    data = (tmp_path / "report.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    assert 4 <= data.count(b"/Type /Page\n") <= 12


def test_links_lead_to_what_they_name(browser: Browser, single: Path) -> None:
    browser.show(single, width=WIDE)
    dead = (
        "[...document.querySelectorAll('a[href^=\"#\"]')].filter(a => !document.querySelector(a.hash)).map(a => a.hash)"
    )
    assert browser.ask(dead) == []
    shown = browser.ask("[...document.querySelectorAll('nav a')].map(a => a.hash.slice(1))")
    assert len(shown) == SECTIONS
    assert browser.ask("document.querySelectorAll('td a[href=\"#latency\"]').length") >= 2, "evidence leads to its plot"
