"""Colours of a report, for light and dark pages, told apart by colour-blind people too.

Plots are drawn once, in marker colours that no palette has; :func:`with_variables` then turns them into CSS variables,
which :func:`style` defines for both kinds of page. The first series follow Okabe and Ito (Color Universal Design,
2008), darkened or lightened where one of them would vanish into the page; the others were searched for so that no two
are close to each other in anybody's eyes. No plot tells series apart by colour alone.
"""

from __future__ import annotations

import re

INK, FAINT, PAGE, GOOD, BAD, UNKNOWN = ("#01f0a1", "#01f0a2", "#01f0a3", "#01f0a4", "#01f0a5", "#01f0a6")
SERIES = tuple(f"#01f0{number:02x}" for number in range(0xB0, 0xB7))
#: Further ways to tell series apart.
DASHES = ("-", "--", "-.", ":")
MARKERS = "os^Dv*P"
HATCHES = ("", "////", "....", "xxxx")

_NAMES = {INK: "ink", FAINT: "faint", PAGE: "page", GOOD: "good", BAD: "bad", UNKNOWN: "unknown"}
_NAMES |= {marker: f"series{number}" for number, marker in enumerate(SERIES)}
LIGHT = {"ink": "#1c1e21", "faint": "#dfe2e7", "page": "#ffffff", "ground": "#f5f6f8", "soft": "#555b64"}
LIGHT |= {"good": "#0072b2", "bad": "#d55e00", "unknown": "#848992", "link": "#005a8e"}
DARK = {"ink": "#e8eaed", "faint": "#343941", "page": "#1b1e23", "ground": "#121417", "soft": "#a9afb9"}
DARK |= {"good": "#56b4e9", "bad": "#ff8a3c", "unknown": "#8a8f98", "link": "#7cc4f0"}
_SERIES_LIGHT = ("#0072b2", "#d55e00", "#00543f", "#b0578d", "#961ff1", "#171057", "#988a5d")
_SERIES_DARK = ("#56b4e9", "#ff8a3c", "#9df0cd", "#e39ac3", "#9445fc", "#cf1e2e", "#9f4c8a")
LIGHT |= {f"series{number}": colour for number, colour in enumerate(_SERIES_LIGHT)}
DARK |= {f"series{number}": colour for number, colour in enumerate(_SERIES_DARK)}

_MARKER = re.compile("|".join(map(re.escape, _NAMES)))


def with_variables(svg: str) -> str:
    """Replace marker colours by CSS variables."""
    return _MARKER.sub(lambda found: f"var(--{_NAMES[found[0]]})", svg)


def style() -> str:
    """CSS that defines the variables for light and dark pages."""
    return (
        f":root{{color-scheme:light dark;{_variables(LIGHT)}}}\n"
        f"@media(prefers-color-scheme:dark){{:root{{{_variables(DARK)}}}}}\n"
    )


def print_style() -> str:
    """CSS that comes last: paper is white whatever the screen is."""
    return f"@media print{{:root{{color-scheme:light;{_variables(LIGHT)}}}}}\n"


def _variables(colours: dict[str, str]) -> str:
    return ";".join(f"--{name}:{colour}" for name, colour in colours.items())
