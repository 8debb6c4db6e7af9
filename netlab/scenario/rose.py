"""The process `rose` of a node: the services of rose that it runs, in the words of a scenario file.

The words are those of a host's own file (docs/rose.md), except that a service is numbered by `service` and `robot`, and
that settings may name a service by its node: `robot1/0.1`.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from netlab.scenario.base import StrictModel, Switch
from netlab.scenario.team_key import TeamKeys
from rose.core.addressing import ROBOTS_PER_HOST, SERVICES_PER_ROBOT

_SERVICE = re.compile(r"(?P<node>[A-Za-z0-9-]+)/(?P<numbers>\d{1,5}\.\d{1,5})")


def _argv(value: object) -> object:
    if isinstance(value, str):
        raise ValueError("argv is a list, one entry per argument; write argv: [python3, service.py]")
    return [str(part) for part in value] if isinstance(value, (list, tuple)) else value


class RoseService(StrictModel):
    """One service; the bounds are rose's own (rose.config)."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$")]
    service: Annotated[int, Field(ge=0, lt=SERVICES_PER_ROBOT)]
    robot: Annotated[int, Field(ge=0, lt=ROBOTS_PER_HOST)] = 0
    run: Annotated[str, Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")] | None = None
    argv: Annotated[tuple[str, ...], Field(min_length=1), BeforeValidator(_argv)] | None = None
    settings: dict[str, Any] = Field(default_factory=dict)
    transport: Literal["udp", "udp_mesh"] = "udp"
    priority: Annotated[int, Field(ge=0, le=255)] = 5
    offline: Literal["discard", "latest", "store"] = "discard"
    hops: Annotated[int, Field(ge=1, le=255)] = 1
    restart: Literal["always", "never"] = "always"

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if (self.run is None) == (self.argv is None):
            raise ValueError("give either run: MODULE:CLASS or argv: [PROGRAM, ...]")
        if (self.robot, self.service) == (0, 0):
            raise ValueError("service 0 of robot 0 is the host's Service Manager; take another number")
        return self

    def named_nodes(self) -> set[str]:
        """The nodes whose services its settings name, whether they exist or not."""
        found = (_SERVICE.fullmatch(value) for value in self.settings.values() if isinstance(value, str))
        return {match["node"] for match in found if match}

    def config(self, addresses: dict[str, str]) -> dict[str, Any]:
        """The entry in the host's file; ``addresses`` by node."""
        values = self.model_dump(exclude_none=True, exclude={"robot", "service"}, mode="json")
        settings = {key: _with_address(value, addresses) for key, value in self.settings.items()}
        return {**values, "id": f"{self.robot}.{self.service}", "settings": settings}


class RoseSettings(StrictModel):
    """The services of one node, or what holds for all nodes at top level; None leaves the top level's."""

    services: tuple[RoseService, ...] = ()
    key: TeamKeys | None = None
    accept_configuration: Switch | None = None

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for what, values in (
            ("names", [service.name for service in self.services]),
            ("numbers", [(service.robot, service.service) for service in self.services]),
        ):
            if len(set(values)) < len(values):
                raise ValueError(f"two services of a node have the same {what}; change one")
        return self

    def host_file(self, base: RoseSettings, address: str, addresses: dict[str, str]) -> dict[str, Any]:
        """The host's own file (docs/rose.md), these settings over ``base``."""
        key = self.key if self.key is not None else base.key
        accepts = self.accept_configuration if self.accept_configuration is not None else base.accept_configuration
        keys = [] if key is None else [key] if isinstance(key, str) else list(key)
        return {
            "host": address,
            **({"keys": keys} if keys else {}),
            **({"accept_configuration": True} if accepts else {}),
            "services": [service.config(addresses) for service in (*base.services, *self.services)],
        }


def _with_address(value: Any, addresses: dict[str, str]) -> Any:
    match = _SERVICE.fullmatch(value) if isinstance(value, str) else None
    return f"{addresses[match['node']]}/{match['numbers']}" if match and match["node"] in addresses else value
