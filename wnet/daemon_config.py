"""The daemon's file: which interfaces, where it answers, and the mesh's settings (:mod:`wnet.config`)."""

from __future__ import annotations

import ipaddress
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from wnet.config import ConfigError, MeshConfig, parse

_IFNAME_BYTES_MAX = 15
_MAC = re.compile("[0-9a-fA-F]{2}(:[0-9a-fA-F]{2}){5}")
_MTU_BYTES = range(576, 9001)


@dataclass(frozen=True, slots=True)
class MemberConfig:
    """One member. Where it is in monitor mode, the interface itself tells."""

    interface: str
    """Its name."""
    radio: bool = False
    """Whether several nodes hear what it sends; else it is a wire to one other node. In monitor mode always."""
    rates_bps: tuple[int, ...] = ()
    """In monitor mode what the radio can send at, rising; empty: 6 to 54 Mbit/s."""
    mac: bytes = b""
    """In monitor mode the address that its frames come from; empty: the interface's own."""


@dataclass(frozen=True, slots=True)
class DaemonConfig:
    """One node's file."""

    members: tuple[MemberConfig, ...]
    """The interfaces over which nodes hear each other; none makes a node alone."""
    interface: str = "wnet0"
    """The mesh interface, which the node's programs see; made if it is not there."""
    address: str = ""
    """IPv4 with prefix length for a mesh interface that the daemon makes; empty: whoever wants one gives it one."""
    mtu_bytes: int = 1500
    """Of a mesh interface that the daemon makes, 576..9000."""
    socket: str = ""
    """Where ``wnet topology|links|routes`` ask; empty: $WNET_SOCKET, /run/wnet.sock or the user's runtime folder."""
    mesh: MeshConfig = field(default_factory=MeshConfig)
    """The table ``[mesh]``."""


def load(path: str) -> DaemonConfig:
    """Read a file.

    Raises:
        ConfigError: It cannot be read, or something in it is wrong; lists every mistake.
    """
    try:
        with Path(path).open("rb") as file:
            table = tomllib.load(file)
    except OSError as error:
        raise ConfigError([f"{path}: {error.strerror}"]) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError([f"{path}: {error}"]) from error
    return parse_file(table, source=path)


def parse_file(table: Mapping[str, object], *, source: str) -> DaemonConfig:
    """Check what was read. Raises ConfigError with every mistake."""
    problems: list[str] = []
    values: dict[str, object] = {}
    for key, value in table.items():
        try:
            if key == "members":
                values[key] = _members(value)
            elif key == "mesh":
                values[key] = parse(_table(value), source=f"{source}: mesh")
            elif key in _CHECKS:
                values[key] = _CHECKS[key](value)
            else:
                known = ", ".join(("members", *_CHECKS, "mesh"))
                problems.append(f"{source}: {key}: unknown key; known are {known}")
        except ConfigError as error:
            problems += error.problems
        except ValueError as error:
            problems.append(f"{source}: {key}: {error}")
    if "members" not in table:
        problems.append(f'{source}: members: missing; name the interfaces, as members = [{{interface = "wlan0"}}]')
    if problems:
        raise ConfigError(problems)
    return replace(DaemonConfig(members=()), **values)  # type: ignore[arg-type]


def _table(value: object) -> Mapping[str, object]:
    if not isinstance(value, dict):
        raise ValueError(f"has to be a table, not {value!r}")
    return value


def _members(value: object) -> tuple[MemberConfig, ...]:
    if not isinstance(value, list):
        raise ValueError('has to be a list of members, as [{interface = "wlan0"}]')
    members = tuple(_member(_table(entry)) for entry in value)
    names = [member.interface for member in members]
    if len(set(names)) < len(names):
        raise ValueError(f"names an interface twice: {', '.join(names)}")
    return members


def _member(entry: Mapping[str, object]) -> MemberConfig:
    unknown = sorted(entry.keys() - {"interface", "radio", "rates_bps", "mac"})
    if unknown:
        raise ValueError(f"unknown key {unknown[0]!r} of a member; known are interface, radio, rates_bps, mac")
    radio, rates_bps = entry.get("radio", False), entry.get("rates_bps", [])
    if not isinstance(radio, bool):
        raise ValueError(f"radio has to be true or false, not {radio!r}")
    if not isinstance(rates_bps, list) or not all(isinstance(rate, int) and rate > 0 for rate in rates_bps):
        raise ValueError(f"rates_bps has to be a list of whole numbers above 0, not {rates_bps!r}")
    return MemberConfig(
        _ifname(entry.get("interface", "")), radio, tuple(sorted(rates_bps)), _mac(entry.get("mac", ""))
    )


def _mac(value: object) -> bytes:
    if value == "":
        return b""
    if not isinstance(value, str) or not _MAC.fullmatch(value) or int(value[:2], 16) & 1:
        raise ValueError(f"mac has to be the address of one station, as 02:00:00:00:00:01, not {value!r}")
    return bytes.fromhex(value.replace(":", ""))


def _ifname(value: object) -> str:
    if not isinstance(value, str) or not 0 < len(value.encode()) <= _IFNAME_BYTES_MAX or "/" in value:
        raise ValueError(f"the name of an interface has 1 to {_IFNAME_BYTES_MAX} bytes, not {value!r}")
    return value


def _address(value: object) -> str:
    if value != "":
        ipaddress.IPv4Interface(value if isinstance(value, str) else "?")
    return str(value)


def _mtu(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value not in _MTU_BYTES:
        raise ValueError(f"has to be a whole number from {_MTU_BYTES[0]} to {_MTU_BYTES[-1]}, not {value!r}")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"has to be text, not {value!r}")
    return value


_CHECKS = {"interface": _ifname, "address": _address, "mtu_bytes": _mtu, "socket": _text}
