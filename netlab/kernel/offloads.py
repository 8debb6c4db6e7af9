"""Switch the transmit offloads of an interface off.

A veth hands frames over in memory with their checksums left to a device that does not exist: whoever reads them with a
packet socket sees wrong checksums, and one 64 kB super-frame counts as one packet in a queue. So everything that leaves
work to the receiver of a frame goes: checksums, scatter-gather, every kind of segmentation.
"""

from __future__ import annotations

import array
import fcntl
import struct

_SIOCETHTOOL = 0x8946

# linux/ethtool.h
_ETHTOOL_GSTRINGS = 0x1B
_ETHTOOL_GSSET_INFO = 0x37
_ETHTOOL_SFEATURES = 0x3B
_ETH_SS_FEATURES = 4
_ETH_GSTRING_LEN = 32

_REQUEST = struct.Struct("16sP16x")


def disable_offloads(fd: int, ifname: str) -> None:
    """Switch transmit checksum, scatter-gather and all segmentation offloads off, in one step.

    Args:
        fd: Any socket of the interface's namespace (a netlink socket serves).
        ifname: The interface.

    Raises:
        OSError: No such interface, or not permitted.
    """
    if not _orders_cache:
        _orders_cache.append(_order(_feature_names(fd, ifname)))
    # A copy: the kernel writes back.
    _ethtool(fd, ifname, array.array("I", _orders_cache[0]))


_orders_cache: list[array.array[int]] = []  # the same for every interface of a kernel


def _order(names: tuple[str, ...]) -> array.array[int]:
    blocks = [0] * ((len(names) + 31) // 32)
    for bit, name in enumerate(names):
        if _is_tx_offload(name):
            blocks[bit // 32] |= 1 << bit % 32
    # Per block: which bits are meant, and their new values. Bits that the driver does not offer are passed over.
    words = [word for block in blocks for word in (block, 0)]
    return array.array("I", [_ETHTOOL_SFEATURES, len(blocks), *words])


def _is_tx_offload(name: str) -> bool:
    return name.startswith(("tx-checksum-", "tx-scatter-gather", "tx-generic-segmentation", "tx-gso-")) or (
        name.startswith("tx-") and name.endswith("-segmentation")
    )


def _feature_names(fd: int, ifname: str) -> tuple[str, ...]:
    """Bit number -> name."""
    count = array.array("I", [_ETHTOOL_GSSET_INFO, 0, 1 << _ETH_SS_FEATURES, 0, 0])
    _ethtool(fd, ifname, count)
    strings = array.array("B", struct.pack("=III", _ETHTOOL_GSTRINGS, _ETH_SS_FEATURES, count[4]))
    strings.frombytes(bytes(count[4] * _ETH_GSTRING_LEN))
    _ethtool(fd, ifname, strings)
    text = strings.tobytes()[12:]
    fields = (text[start : start + _ETH_GSTRING_LEN] for start in range(0, len(text), _ETH_GSTRING_LEN))
    return tuple(field.split(b"\0")[0].decode() for field in fields)


def _ethtool(fd: int, ifname: str, command: array.array[int]) -> None:
    """``command`` is read and, for queries, written by the kernel in place."""
    fcntl.ioctl(fd, _SIOCETHTOOL, _REQUEST.pack(ifname.encode(), command.buffer_info()[0]))
