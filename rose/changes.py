"""What has to happen so that a host runs other services than it does. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from rose.config.model import ServiceConfig


@dataclass(frozen=True, slots=True)
class Changes:
    """Services by their new configuration; ``stop`` by the old one. Whoever is in none of them goes on undisturbed."""

    stop: tuple[ServiceConfig, ...] = ()
    start: tuple[ServiceConfig, ...] = ()
    configure: tuple[ServiceConfig, ...] = ()


def changes(old: Sequence[ServiceConfig], new: Sequence[ServiceConfig]) -> Changes:
    """Compare by robot and service: other settings are sent to the running service, anything else starts it anew."""
    before = {(config.robot, config.service): config for config in old}
    after = {(config.robot, config.service): config for config in new}
    stop = [config for numbers, config in before.items() if not _same_process(config, after.get(numbers))]
    start = [config for numbers, config in after.items() if not _same_process(config, before.get(numbers))]
    configure = [
        config
        for numbers, config in after.items()
        if config not in start and config.settings != before[numbers].settings
    ]
    return Changes(tuple(stop), tuple(start), tuple(configure))


def _same_process(one: ServiceConfig, other: ServiceConfig | None) -> bool:
    return other is not None and msgspec.structs.replace(one, settings={}) == msgspec.structs.replace(
        other, settings={}
    )
