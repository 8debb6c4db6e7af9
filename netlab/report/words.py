"""How a report writes what the rest of the project writes in plain ASCII."""

from __future__ import annotations

from collections.abc import Sequence

_SIGNS = {"->": "→", "<=": "≤", ">=": "≥"}


def typeset(text: str) -> str:
    """Arrows and comparison signs as people write them."""
    for plain, sign in _SIGNS.items():
        text = text.replace(plain, sign)
    return text


def counted(count: int, what: str) -> str:
    """A number and its noun."""
    return f"{count} {what}{'s' * (count != 1)}"


def listed(numbers: Sequence[int]) -> str:
    """Write ascending numbers shortly: 1, 2, 3, 5 as "1–3, 5"."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}–{run[-1]}" for run in runs)
