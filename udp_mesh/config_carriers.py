"""The ``carriers`` of a configuration: what a daemon sends and receives by."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

MIN_SERIAL_FRAME_BYTES = 200
MAX_SERIAL_FRAME_BYTES = 65_000
_BITS_PER_BYTE = 10  # start, eight, stop


class CarrierKind(StrEnum):
    """What is under a carrier."""

    UDP = "udp"
    UDP6 = "udp6"
    ETHERNET = "ethernet"
    SERIAL = "serial"


@dataclass(frozen=True, slots=True)
class CarrierConfig:
    """One entry of ``carriers``.

    ``kind`` is ``udp`` (IPv4 and its broadcast), ``udp6`` (IPv6, link-local, multicast), ``ethernet`` (frames of their
    own type, no IP) or ``serial``. The first three use every interface named in ``interfaces``; empty: those of the
    whole daemon.
    """

    kind: CarrierKind
    interfaces: tuple[str, ...] = ()
    device: str = ""
    """Of a serial line, such as /dev/ttyUSB0."""
    baud: int = 0
    """Of a serial line; 0 leaves it as it is."""
    mtu_bytes: int = 1024
    """Longest frame on a serial line, 200..65000."""
    rate_bps: float = 0.0
    """What a serial line carries; 0: 8 of 10 bauds, or unknown without them."""


_KEYS = {
    CarrierKind.UDP: ("kind", "interfaces"),
    CarrierKind.UDP6: ("kind", "interfaces"),
    CarrierKind.ETHERNET: ("kind", "interfaces"),
    CarrierKind.SERIAL: ("kind", "device", "baud", "mtu_bytes", "rate_bps"),
}
DEFAULT = (CarrierConfig(CarrierKind.UDP),)


def check(value: object) -> object:
    """Check the whole list.

    Raises:
        ValueError: With the first mistake.
    """
    if not isinstance(value, list) or not value or not all(isinstance(entry, dict) for entry in value):
        raise ValueError('has to be tables like [[carriers]] with kind = "udp"')
    carriers = tuple(_entry(entry, number) for number, entry in enumerate(value))
    devices = [carrier.device for carrier in carriers if carrier.device]
    if len(set(devices)) < len(devices):
        raise ValueError("names one device twice")
    return carriers


def _entry(entry: Mapping[str, object], number: int) -> CarrierConfig:
    kinds = [kind.value for kind in CarrierKind]
    if entry.get("kind") not in kinds:
        raise ValueError(f"[{number}].kind has to be one of {', '.join(kinds)}")
    kind = CarrierKind(str(entry["kind"]))
    for key in entry:
        if key not in _KEYS[kind]:
            raise ValueError(f"[{number}].{key} is no key of kind {kind.value}; known are {', '.join(_KEYS[kind])}")
    values: dict[str, object] = {}
    for key, value in entry.items():
        if key != "kind":
            expected, is_right = _VALUES[key]
            if not is_right(value):
                raise ValueError(f"[{number}].{key} has to be {expected}")
            values[key] = tuple(value) if isinstance(value, list) else value
    if kind is CarrierKind.SERIAL and "device" not in values:
        raise ValueError(f"[{number}] needs device, such as /dev/ttyUSB0")
    carrier = CarrierConfig(kind, **values)  # type: ignore[arg-type]
    if carrier.baud and not carrier.rate_bps:
        return CarrierConfig(kind, **{**values, "rate_bps": 8 * carrier.baud / _BITS_PER_BYTE})  # type: ignore[arg-type]
    return carrier


def _is_names(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) and 0 < len(name) < 16 for name in value)


def _is_number(value: object, low: float, high: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _is_speed(value: object) -> bool:
    from udp_mesh.io.serial import SPEEDS  # only for whom it concerns

    return value in SPEEDS


_VALUES: dict[str, tuple[str, Callable[[object], bool]]] = {
    "interfaces": ('a list of interface names like ["wlan0"]', _is_names),
    "device": ("a path such as /dev/ttyUSB0", lambda value: isinstance(value, str) and value.startswith("/")),
    "baud": ("a speed that serial lines have, such as 9600, 57600 or 115200", _is_speed),
    "mtu_bytes": (
        f"a whole number from {MIN_SERIAL_FRAME_BYTES} to {MAX_SERIAL_FRAME_BYTES}",
        lambda value: isinstance(value, int) and _is_number(value, MIN_SERIAL_FRAME_BYTES, MAX_SERIAL_FRAME_BYTES),
    ),
    "rate_bps": ("a number of bits per second from 300 to 1e9", lambda value: _is_number(value, 300, 1e9)),
}


def describe(carriers: tuple[CarrierConfig, ...]) -> list[dict[str, object]]:
    """Return carriers as plain values, as a file has them."""
    found = []
    for carrier in carriers:
        values: dict[str, object] = {key: getattr(carrier, key) for key in _KEYS[carrier.kind]}
        found.append(values)
    return found
