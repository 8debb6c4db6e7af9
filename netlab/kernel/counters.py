"""What the kernel has counted at qdiscs and at the filters' mirror actions. Asks; changes nothing.

Sources: linux/gen_stats.h, linux/pkt_sched.h, linux/pkt_cls.h, linux/tc_act/tc_mirred.h, net/sched/act_api.c.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from netlab.kernel import messages
from netlab.kernel.netlink import HEADER, NetlinkSocket, attributes

_RTM_GETQDISC = 38
_RTM_GETACTION = 50

_TCMSG = struct.Struct("=B3xiIII")  # family, interface index, handle, parent, info
_TCAMSG = struct.Struct("=B3x")
_IFINFOMSG = struct.Struct("=BxHiII")
_ATTRIBUTE = struct.Struct("=HH")
_NESTED = 0x8000

_TCA_KIND, _TCA_OPTIONS, _TCA_STATS2 = 1, 2, 7
_TCA_STATS_QUEUE = 3
_QUEUE_STATS = struct.Struct("=5I")  # qlen, backlog, drops, requeues, overlimits
_ROOT = 0xFFFFFFFF

_TCA_ROOT_TAB, _TCA_ROOT_FLAGS = 1, 2
_LARGE_DUMP = struct.pack("=II", 1, 1)  # TCA_ACT_FLAG_LARGE_DUMP_ON: value, selector
_TCA_ACT_KIND, _TCA_ACT_OPTIONS, _TCA_ACT_STATS = 1, 2, 4
_TCA_MIRRED_PARMS = 2
_MIRRED_IFINDEX = struct.Struct("=24xI")  # the last field of struct tc_mirred

_IFLA_CARRIER_DOWN_COUNT = 48


@dataclass(frozen=True, slots=True)
class QdiscCounters:
    """One qdisc since it was made, but for ``waiting``, which is now. All count frames.

    sch_netem counts what its loss model takes and what finds its queue full alike as ``drops``, and what leaves ahead
    of the delayed frames as ``requeues``. ``options`` are the qdisc's settings as the kernel dumps them.
    """

    kind: str
    waiting: int
    drops: int
    requeues: int
    options: bytes = b""


def root_qdiscs(sock: NetlinkSocket) -> dict[int, QdiscCounters]:
    """The root qdisc of every interface of the socket's namespace that has one, by interface index."""
    found = {}
    for answer in sock.dump(_dump(_RTM_GETQDISC, _TCMSG.pack(0, 0, 0, 0, 0))):
        _, index, _, parent, _ = _TCMSG.unpack_from(answer, HEADER.size)
        if parent == _ROOT:
            attrs = attributes(answer, HEADER.size + _TCMSG.size)
            waiting, _, drops, requeues, _ = _queue_stats(attrs.get(_TCA_STATS2, b""))
            options = attrs.get(_TCA_OPTIONS, b"")
            found[index] = QdiscCounters(_text(attrs[_TCA_KIND]), waiting, drops, requeues, options)
    return found


def mirred_refusals(sock: NetlinkSocket) -> dict[int, int]:
    """How many frames the ``mirred`` actions of the socket's namespace could not hand on, by target interface.

    What the target's qdisc refuses to queue counts, and so does what meets a target that is down or has no carrier
    (tcf_mirred_act() in net/sched/act_mirred.c). What netem's loss model takes does not: to its caller netem claims
    that it has queued the frame.
    """
    refusals: dict[int, int] = {}
    kind = _attribute(_TCA_ACT_KIND, b"mirred\0")
    tab = _attribute(_TCA_ROOT_TAB | _NESTED, _attribute(1 | _NESTED, kind))
    body = _TCAMSG.pack(0) + tab + _attribute(_TCA_ROOT_FLAGS, _LARGE_DUMP)
    for answer in sock.dump(_dump(_RTM_GETACTION, body)):
        tab = attributes(answer, HEADER.size + _TCAMSG.size).get(_TCA_ROOT_TAB, b"")
        for action in attributes(tab, 0).values():
            attrs = attributes(action, 0)
            parameters = attributes(attrs[_TCA_ACT_OPTIONS], 0)[_TCA_MIRRED_PARMS]
            (target,) = _MIRRED_IFINDEX.unpack_from(parameters)
            refusals[target] = refusals.get(target, 0) + _queue_stats(attrs.get(_TCA_ACT_STATS, b""))[4]
    return refusals


def carrier_losses(sock: NetlinkSocket) -> dict[int, int]:
    """How often each interface of the socket's namespace has lost its carrier, by interface index."""
    found = {}
    for answer in sock.dump(messages.encode_dump_links()):
        attrs = attributes(answer, HEADER.size + _IFINFOMSG.size)
        index = _IFINFOMSG.unpack_from(answer, HEADER.size)[2]
        found[index] = int.from_bytes(attrs.get(_IFLA_CARRIER_DOWN_COUNT, b""), "little")
    return found


def _queue_stats(stats: bytes) -> tuple[int, int, int, int, int]:
    queue = attributes(stats, 0).get(_TCA_STATS_QUEUE, bytes(_QUEUE_STATS.size))
    waiting, backlog, drops, requeues, overlimits = _QUEUE_STATS.unpack_from(queue)
    return waiting, backlog, drops, requeues, overlimits


def _dump(kind: int, body: bytes) -> bytes:
    flags = messages.NLM_F_REQUEST | messages.NLM_F_DUMP
    return HEADER.pack(HEADER.size + len(body), kind, flags, 0, 0) + body


def _attribute(kind: int, payload: bytes) -> bytes:
    return _ATTRIBUTE.pack(_ATTRIBUTE.size + len(payload), kind) + payload + bytes(-len(payload) % 4)


def _text(value: bytes) -> str:
    return value.rstrip(b"\0").decode()
