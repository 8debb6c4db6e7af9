"""Colours of a report, for light and dark pages, told apart by colour-blind people too.

Plots are drawn once, in marker colours that no palette has; :func:`with_variables` then turns them into CSS variables,
which :func:`style` defines for both kinds of page. Series follow Okabe and Ito (Color Universal Design, 2008), darkened
or lightened where one of them would vanish into the page.
"""

from __future__ import annotations

import re

INK, FAINT, PAGE, GOOD, BAD, UNKNOWN = ("#01f0a1", "#01f0a2", "#01f0a3", "#01f0a4", "#01f0a5", "#01f0a6")
SERIES = tuple(f"#01f0{number:02x}" for number in range(0xB0, 0xB7))
#: A second way to tell series apart.
DASHES = ("-", "--", "-.", ":")

_NAMES = {INK: "ink", FAINT: "faint", PAGE: "page", GOOD: "good", BAD: "bad", UNKNOWN: "unknown"}
_NAMES |= {marker: f"series{number}" for number, marker in enumerate(SERIES)}
LIGHT = {"ink": "#1c1e21", "faint": "#d9dce1", "page": "#ffffff"}
LIGHT |= {"good": "#0072b2", "bad": "#d55e00", "unknown": "#8a8f98"}
DARK = {"ink": "#e4e6ea", "faint": "#3a3f47", "page": "#16181c"}
DARK |= {"good": "#56b4e9", "bad": "#ff8a3c", "unknown": "#8a8f98"}
_SERIES_LIGHT = ("#0072b2", "#d55e00", "#008060", "#b0578d", "#8a6d00", "#3d8fc4", "#5b5f66")
_SERIES_DARK = ("#56b4e9", "#ff8a3c", "#2fc79b", "#e39ac3", "#f0e442", "#a7c8ff", "#b4b9c2")
LIGHT |= {f"series{number}": colour for number, colour in enumerate(_SERIES_LIGHT)}
DARK |= {f"series{number}": colour for number, colour in enumerate(_SERIES_DARK)}

_MARKER = re.compile("|".join(map(re.escape, _NAMES)))


def with_variables(svg: str) -> str:
    """Replace marker colours by CSS variables."""
    return _MARKER.sub(lambda found: f"var(--{_NAMES[found[0]]})", svg)


def style() -> str:
    """CSS that defines the variables for light and dark pages."""
    light, dark = (";".join(f"--{name}:{colour}" for name, colour in colours.items()) for colours in (LIGHT, DARK))
    return f":root{{color-scheme:light dark;{light}}}\n@media(prefers-color-scheme:dark){{:root{{{dark}}}}}"
