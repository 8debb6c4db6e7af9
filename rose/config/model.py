"""What a host runs, as values, and how it is read from a file. Nothing is started here.

host: 10.0.0.114
keys: [64 hexadecimal digits]          # of the team; {of: 10.0.0.7/0.1, text: ...} is that of one service
services:
  - name: laser
    id: 0.1                            # ROBOT.SERVICE
    run: rose.examples.laser:Laser
    settings: {rate_hz: 10.0}
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path

import msgspec

from rose.config.tree import Block, Complaints, Node, describe, plain
from rose.config.xml_file import read_xml
from rose.config.yaml_file import read_yaml
from rose.core.addressing import Host, ServiceId, collisions
from rose.core.keys import KEYS_MAX, KeyRing, parse_key
from rose.errors import AddressError, ConfigError

MANAGER = (0, 0)
"""Robot and service of every host's Service Manager."""
_NUMBERS = re.compile(r"(\d{1,5})\.(\d{1,5})")
_RUN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


class ServiceConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One service: its numbers, what is run (``run`` is MODULE:CLASS, or ``argv`` a program), and how it is carried.

    ``priority`` 0..255, lower is more urgent: marks datagrams for the network (DSCP), and is udp_mesh's own.
    """

    name: str
    robot: int
    service: int
    run: str = ""
    argv: tuple[str, ...] = ()
    settings: dict[str, object] = {}
    transport: str = "udp"
    priority: int = 5
    offline: str = "discard"
    hops: int = 1
    restart: bool = True


@dataclass(frozen=True, slots=True)
class HostConfig:
    """All of one host. ``accepts``: whether a Configuration Manager may replace the services over the network."""

    host: Host
    services: tuple[ServiceConfig, ...]
    keys: KeyRing = field(default_factory=KeyRing)
    accepts: bool = False
    fresh_s: float = 60.0

    @property
    def manager(self) -> ServiceId:
        """The id of the host's Service Manager."""
        return ServiceId(self.host, *MANAGER)


@dataclass(frozen=True, slots=True)
class TeamConfig:
    """Many hosts in one file, for a Configuration Manager that runs as service ``sid``."""

    sid: ServiceId
    hosts: Mapping[Host, HostConfig]
    keys: KeyRing
    fresh_s: float = 60.0


def load_host(path: Path) -> HostConfig:
    """Read one host's file, XML where its name ends so, else YAML.

    Raises:
        ConfigError: With every mistake.
    """
    complaints, root = _read(path)
    block = Block(root, complaints)
    keys = _keys(block)
    config = _host(block, _address(block, "host"), keys)
    block.finish()
    return _checked(config, complaints)


def load_team(path: Path) -> TeamConfig:
    """Read the file of a Configuration Manager: ``host`` is where it runs, ``hosts`` whom it configures.

    Raises:
        ConfigError: With every mistake.
    """
    complaints, root = _read(path)
    block = Block(root, complaints)
    own, keys = _address(block, "host"), _keys(block)
    hosts: dict[Host, HostConfig] = {}
    for text, node in Block(block.node("hosts") or Node({}, block.line), complaints, "hosts").entries():
        inside = Block(node, complaints, f"hosts.{text}")
        try:
            address = ServiceId(ip_address(text), *MANAGER).host
        except ValueError as error:
            complaints.add(node.line, "hosts", str(error))
            continue
        config = _host(inside, address, keys)
        if config is not None:
            hosts[address] = config
        inside.finish()
    if not hosts:
        complaints.add(block.line, "hosts", "is missing; add a block of hosts by address")
    if not keys:
        complaints.add(block.line, "keys", "is missing; hosts take their configuration only from who has a key")
    numbers = _id(block, "id", default="0.1023")
    fresh_s = block.number("fresh_s", 60.0, least=0.1, most=1e9)
    block.finish()
    if complaints.problems or own is None or numbers is None:
        raise ConfigError(complaints.problems)
    return TeamConfig(ServiceId(own, *numbers), hosts, keys, fresh_s)


# -- inside -------------------------------------------------------------------------------------------------------


def _read(path: Path) -> tuple[Complaints, Node]:
    complaints = Complaints(str(path))
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError([f"{path}: cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError:
        raise ConfigError([f"{path}: is not text"]) from None
    read = read_xml if path.suffix.lower() == ".xml" else read_yaml
    root = read(text, complaints)
    if root is None or complaints.problems:
        raise ConfigError(complaints.problems)
    return complaints, root


def _address(block: Block, key: str) -> Host | None:
    text = block.text(key)
    try:
        return ServiceId(ip_address(text), 0, 0).host if text else None
    except ValueError as error:
        reason = str(error) if isinstance(error, AddressError) else f"'{text}' is no IP address"
        block.complain(block.line, key, reason)
        return None


def _host(block: Block, host: Host | None, keys: KeyRing) -> HostConfig | None:
    accepts = block.switch("accept_configuration", False)
    if accepts and not keys:
        block.complain(block.line, "accept_configuration", "needs keys; else anybody could start programs here")
    fresh_s = block.number("fresh_s", 60.0, least=0.1, most=1e9)
    services = []
    first: dict[object, int] = {}
    for place, node in enumerate(block.items("services")):
        service = _service(Block(node, block.complaints, f"services[{place}]"), host)
        if service is None:
            continue
        services.append(service)
        for key, value in (("name", service.name), ("id", (service.robot, service.service))):
            if first.setdefault(value, place) != place:
                block.complain(node.line, f"services[{place}].{key}", f"is that of services[{first[value]}] too")
    return None if host is None else HostConfig(host, tuple(services), keys, accepts, fresh_s)


def _service(block: Block, host: Host | None) -> ServiceConfig | None:
    numbers = _id(block, "id")
    robot, service = numbers or (0, 1)
    name = block.text("name", f"{robot}.{service}")
    run = block.text("run", "")
    argv = block.items("argv")
    if bool(run) == bool(argv):
        block.complain(block.line, "run", "give either run: MODULE:CLASS or argv: [PROGRAM, ...]")
    elif run and not _RUN.fullmatch(run):
        block.complain(block.line, "run", f"'{run}' is not MODULE:CLASS, such as rose.examples.laser:Laser")
    settings_node = block.node("settings")
    settings = plain(settings_node) if settings_node is not None else {}
    if not isinstance(settings, dict):
        block.complain(block.line, "settings", f"expected a block of keys, found {describe(settings)}")
        settings = {}
    if numbers == MANAGER:
        block.complain(block.line, "id", "0.0 is the Service Manager's own; take another")
    elif host is not None:
        try:
            ServiceId(host, robot, service)
        except AddressError as error:
            block.complain(block.line, "id", str(error))
    config = ServiceConfig(
        name=name,
        robot=robot,
        service=service,
        run=run,
        argv=tuple(item.written for item in argv),
        settings=settings,
        transport=block.text("transport", "udp", choices=("udp", "udp_mesh")),
        priority=int(block.number("priority", 5, least=0, most=255)),
        offline=block.text("offline", "discard", choices=("discard", "latest", "store")),
        hops=int(block.number("hops", 1, least=1, most=255)),
        restart=block.text("restart", "always", choices=("always", "never")) == "always",
    )
    block.finish()
    return None if numbers is None else config


def _id(block: Block, key: str, default: str | None = None) -> tuple[int, int] | None:
    node = block.node(key)
    text = (default or "") if node is None else node.written
    found = _NUMBERS.fullmatch(text)
    if found is None:
        line = block.line if node is None else node.line
        what = "is missing; add it" if node is None else f"'{text}' is not ROBOT.SERVICE, such as 0.1"
        block.complain(line, key, what)
        return None
    return int(found[1]), int(found[2])


def _keys(block: Block) -> KeyRing:
    team: list[bytes] = []
    by_service: dict[ServiceId, list[bytes]] = {}
    for place, node in enumerate(block.items("keys")):
        inside = node.value if isinstance(node.value, dict) else {}
        of, text = inside.get("of"), inside.get("text", node if not inside else None)
        try:
            key = parse_key(text.written if text is not None else "")
            own = team if of is None else by_service.setdefault(ServiceId.parse(of.written), [])
            own.append(key)
            if len(own) > KEYS_MAX:
                raise ValueError(f"more than {KEYS_MAX} keys; remove the oldest")
        except ValueError as error:
            block.complain(node.line, f"keys[{place}]", str(error))
    return KeyRing(by_service, team)


def _checked(config: HostConfig | None, complaints: Complaints) -> HostConfig:
    if complaints.problems or config is None:
        raise ConfigError(complaints.problems)
    return config


def team_collisions(team: TeamConfig) -> list[tuple[ServiceId, ServiceId]]:
    """Return services of different hosts that share a multicast group, because the hosts' last bytes are the same."""
    return collisions([ServiceId(h.host, s.robot, s.service) for h in team.hosts.values() for s in h.services])
