"""Keys of a team, as `udp-mesh key` and `wnet key` print them."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import BeforeValidator, Field

_TEAM_KEY = re.compile("[0-9a-fA-F]{64}")


def _quoted_key(value: object) -> object:
    keys = value if isinstance(value, (list, tuple)) else [value]
    if not 0 < len(keys) <= 4 or not all(isinstance(key, str) and _TEAM_KEY.fullmatch(key) for key in keys):
        raise ValueError(
            "expected 64 hexadecimal digits in quotes, such as `udp-mesh key` prints, or a list of 1 to 4 such keys"
        )
    return value


TeamKey = Annotated[str, Field(pattern=f"^{_TEAM_KEY.pattern}$")]
#: One key, or a list: the first seals, all open.
TeamKeys = Annotated[TeamKey | tuple[TeamKey, ...], BeforeValidator(_quoted_key)]
