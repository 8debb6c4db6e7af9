"""rtnetlink messages about qdiscs, filters and actions, encoded by pyroute2. Sends nothing.

Filters stand at the ingress of a device (clsact) and hand frames on with ``mirred``. Two sets of classifiers say the
same: matchall with flower, or u32, whichever the kernel has.
"""

from __future__ import annotations

import functools
import socket
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from pyroute2.netlink import nla, nlmsg
from pyroute2.netlink.rtnl.tcmsg import tcmsg
from pyroute2.netlink.rtnl.tcmsg.cls_matchall import options as matchall_options
from pyroute2.netlink.rtnl.tcmsg.common_act import tca_act_prio

from netlab.kernel.messages import (
    NLM_F_CREATE,
    NLM_F_EXCL,
    RTM_NEWQDISC,
    RTM_NEWTFILTER,
    encode_message,
)
from netlab.kernel.netem import NetemOptions, netem_options
from netlab.kernel.templates import Template
from netlab.medium.impairments import PERFECT, Impairment

ACTIONS_MAX = 31  # TCA_ACT_MAX_PRIO in linux/pkt_cls.h, less the unused number 0

_ROOT = 0xFFFFFFFF
_CLSACT = 0xFFFFFFF1
_CLSACT_HANDLE = 0xFFFF0000
_CLSACT_INGRESS = 0xFFFFFFF2
_NETEM_HANDLE = 0x10000  # 1:
_ETH_P_ALL = 0x0003

# linux/pkt_cls.h, linux/tc_act/tc_mirred.h
_TC_ACT_UNSPEC = -1  # go on with the next filter
_TC_ACT_PIPE = 3
_TC_ACT_STOLEN = 4
_EGRESS_REDIR = 1
_EGRESS_MIRROR = 2
_U32_TERMINAL = 1

_TCA_NETEM_PRNG_SEED = 14
_MARK = 0x7AB1C2D3
_MARK_SEED = 0x7AB4C5D6E7F8A9BA


class Classifier(StrEnum):
    """How frames are told apart; the kernel's modules have these names."""

    FLOWER = "flower"  # with matchall where every frame is meant
    U32 = "u32"


@dataclass(frozen=True, slots=True)
class Match:
    """Frames whose destination MAC, masked, equals ``value``; a mask of zeros means every frame. 6 bytes each."""

    value: bytes
    mask: bytes


ANY = Match(bytes(6), bytes(6))
GROUP = Match(b"\x01" + bytes(5), b"\x01" + bytes(5))  # broadcast and multicast: the I/G bit


def match_mac(mac: bytes) -> Match:
    """Frames for exactly this MAC."""
    return Match(mac, b"\xff" * 6)


class _FlowerOptions(nla):  # type: ignore[misc]  # pyroute2 is untyped and knows no flower
    prefix = "TCA_FLOWER_"
    nla_map = (
        (3, "TCA_FLOWER_ACT", "actions"),
        (4, "TCA_FLOWER_KEY_ETH_DST", "l2addr"),
        (5, "TCA_FLOWER_KEY_ETH_DST_MASK", "l2addr"),
        (22, "TCA_FLOWER_FLAGS", "uint32"),
    )
    actions = tca_act_prio


class _U32Options(nla):  # type: ignore[misc]
    """pyroute2's own u32 keys start at the network header at the earliest; the MAC address lies 14 bytes before it."""

    prefix = "TCA_U32_"
    nla_map = ((5, "TCA_U32_SEL", "u32_sel"), (7, "TCA_U32_ACT", "actions"))
    actions = tca_act_prio

    class u32_sel(nla):  # type: ignore[misc]
        fields = (
            ("flags", "B"),
            ("offshift", "B"),
            ("nkeys", "B"),
            ("__align", "x"),
            ("offmask", ">H"),
            ("off", "H"),
            ("offoff", "h"),
            ("hoff", "h"),
            ("hmask", ">I"),
            ("mask0", ">I"),
            ("value0", ">I"),
            ("off0", "i"),
            ("offmask0", "i"),
            ("mask1", ">I"),
            ("value1", ">I"),
            ("off1", "i"),
            ("offmask1", "i"),
        )


_OPTIONS = {"netem": NetemOptions, "matchall": matchall_options, "flower": _FlowerOptions, "u32": _U32Options}


class _Message(nlmsg):  # type: ignore[misc]
    """struct tcmsg with the options that the lab uses.

    Not a subclass of pyroute2's tcmsg: pyroute2 keeps a class's compiled attribute table where subclasses find it, and
    then a subclass behaves like its parent if the parent was used first.
    """

    prefix = "TCA_"
    fields = tcmsg.fields
    nla_map = (("TCA_UNSPEC", "none"), ("TCA_KIND", "asciiz"), ("TCA_OPTIONS", "options_class"))

    @staticmethod
    def options_class(self: Any, *argv: Any, **kwarg: Any) -> Any:
        """Choose the class of TCA_OPTIONS by the message's kind; pyroute2 passes the message, static or not."""
        return _OPTIONS[self.get_attr("TCA_KIND")]


def add_netem(ifindex: int, impairment: Impairment, *, seed: int) -> bytes:
    """Make a netem qdisc the root of an interface that has none.

    Raises:
        ValueError: sch_netem cannot express the impairment.
    """
    return _netem(ifindex, impairment, seed, False, NLM_F_CREATE | NLM_F_EXCL)


def add_inner_netem(ifindex: int) -> bytes:
    """Put another netem inside that qdisc; the lab never does, but some kernels then refuse things: to try them."""
    options = netem_options(PERFECT, seed=_MARK_SEED, replace_table=False)
    return _encode(ifindex, RTM_NEWQDISC, "netem", options, handle=_NETEM_HANDLE + 0x10000, parent=_NETEM_HANDLE + 1)


def change_netem(ifindex: int, impairment: Impairment, *, seed: int, replace_table: bool) -> bytes:
    """Change that qdisc in place: frames in its queue keep their times of departure.

    Args:
        ifindex: The interface.
        impairment: What the qdisc does from now on.
        seed: Another one at every change.
        replace_table: Some earlier impairment of this qdisc left a delay table in it.

    Raises:
        ValueError: sch_netem cannot express the impairment.
    """
    return _netem(ifindex, impairment, seed, replace_table, 0)


def add_clsact(ifindex: int) -> bytes:
    """Give an interface the place where ingress filters stand."""
    return _encode(ifindex, RTM_NEWQDISC, "clsact", None, handle=_CLSACT_HANDLE, parent=_CLSACT)


def add_filter(
    ifindex: int, priority: int, match: Match, targets: Sequence[int], *, classifier: Classifier, last: bool = True
) -> bytes:
    """Hand frames that match to the egress of every interface in ``targets``; nothing else sees them.

    Args:
        ifindex: Where they come in.
        priority: 1..65535, unique on this interface; lower ones are asked first.
        match: Which frames.
        targets: Interface indices, 1 to ``ACTIONS_MAX``.
        classifier: What the kernel has.
        last: False copies to all targets and goes on with the next filter (for more than ``ACTIONS_MAX`` targets).

    Raises:
        ValueError: No targets or too many.
    """
    if not 1 <= len(targets) <= ACTIONS_MAX:
        raise ValueError(f"{len(targets)} targets in one filter; at least 1 and at most {ACTIONS_MAX}")
    actions = {"attrs": [(f"TCA_ACT_PRIO_{n}", act) for n, act in enumerate(_actions(targets, last), start=1)]}
    kind, options = _BUILDERS[classifier](match, actions)
    info = socket.htons(_ETH_P_ALL) | priority << 16
    return _encode(ifindex, RTM_NEWTFILTER, kind, options, parent=_CLSACT_INGRESS, info=info)


def add_empty_filter(ifindex: int, priority: int, kind: str) -> bytes:
    """A filter that says nothing, to learn from the refusal whether the kernel knows its kind."""
    info = socket.htons(_ETH_P_ALL) | priority << 16
    return _encode(ifindex, RTM_NEWTFILTER, kind, None, parent=_CLSACT_INGRESS, info=info)


def encode_netem(ifindex: int, impairment: Impairment, *, seed: int, replace_table: bool, flags: int) -> bytes:
    """The same by plain pyroute2: ``add_netem`` and ``change_netem`` fill a template of it."""
    options = netem_options(impairment, seed=seed, replace_table=replace_table)
    return _encode(ifindex, RTM_NEWQDISC, "netem", options, handle=_NETEM_HANDLE, parent=_ROOT, flags=flags)


def _netem(ifindex: int, impairment: Impairment, seed: int, replace_table: bool, flags: int) -> bytes:
    template = _netem_template(impairment, replace_table, flags)
    return template.fill({"ifindex": _ifindex_hole(ifindex), "seed": _seed_hole(seed)})


@functools.lru_cache(maxsize=4096)
def _netem_template(impairment: Impairment, replace_table: bool, flags: int) -> Template:
    message = encode_netem(_MARK, impairment, seed=_MARK_SEED, replace_table=replace_table, flags=flags)
    return Template(message, {"ifindex": _ifindex_hole(_MARK), "seed": _seed_hole(_MARK_SEED)})


# The holes take their fixed neighbours along: 12 bytes that no impairment's values can imitate by chance.
def _ifindex_hole(ifindex: int) -> bytes:
    return struct.pack("=III", ifindex, _NETEM_HANDLE, _ROOT)


def _seed_hole(seed: int) -> bytes:
    return struct.pack("=HHQ", 12, _TCA_NETEM_PRNG_SEED, seed)


def _encode(
    ifindex: int,
    kind: int,
    name: str,
    options: dict[str, Any] | None,
    *,
    handle: int = 0,
    parent: int,
    info: int = 0,
    flags: int = NLM_F_CREATE | NLM_F_EXCL,
) -> bytes:
    message = _Message()
    message["index"] = ifindex
    message["handle"] = handle
    message["parent"] = parent
    message["info"] = info
    message["attrs"] = [("TCA_KIND", name)]
    if options is not None:
        message["attrs"].append(("TCA_OPTIONS", options))
    return encode_message(message, kind, flags)


def _actions(targets: Sequence[int], last: bool) -> list[dict[str, Any]]:
    mirrored = targets[:-1] if last else targets
    made = [_mirred(_EGRESS_MIRROR, ifindex, _TC_ACT_PIPE) for ifindex in mirrored[:-1]]
    if mirrored:
        made.append(_mirred(_EGRESS_MIRROR, mirrored[-1], _TC_ACT_PIPE if last else _TC_ACT_UNSPEC))
    if last:
        made.append(_mirred(_EGRESS_REDIR, targets[-1], _TC_ACT_STOLEN))
    return made


def _mirred(kind: int, ifindex: int, verdict: int) -> dict[str, Any]:
    parameters = {"action": verdict, "eaction": kind, "ifindex": ifindex}
    return {
        "attrs": [
            ("TCA_ACT_KIND", "mirred"),
            ("TCA_ACT_OPTIONS", {"attrs": [("TCA_MIRRED_PARMS", parameters)]}),
        ]
    }


def _flower(match: Match, actions: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    if match == ANY:
        return "matchall", {"attrs": [("TCA_MATCHALL_ACT", actions)]}
    keys = [
        ("TCA_FLOWER_KEY_ETH_DST", match.value.hex(":")),
        ("TCA_FLOWER_KEY_ETH_DST_MASK", match.mask.hex(":")),
    ]
    return "flower", {"attrs": [*keys, ("TCA_FLOWER_ACT", actions), ("TCA_FLOWER_FLAGS", 0)]}


def _u32(match: Match, actions: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    # Keys are words at multiples of four from the network header; the MAC header begins 14 bytes before it.
    selector = {"flags": _U32_TERMINAL, "nkeys": 2}
    for field in ("offshift", "offmask", "off", "offoff", "hoff", "hmask", "offmask0", "offmask1"):
        selector[field] = 0
    value, mask = bytes(2) + match.value, bytes(2) + match.mask
    for key, start, offset in ((0, 0, -16), (1, 4, -12)):
        selector[f"mask{key}"] = int.from_bytes(mask[start : start + 4], "big")
        selector[f"value{key}"] = int.from_bytes(value[start : start + 4], "big")
        selector[f"off{key}"] = offset
    return "u32", {"attrs": [("TCA_U32_ACT", actions), ("TCA_U32_SEL", selector)]}


_BUILDERS: dict[Classifier, Callable[[Match, dict[str, Any]], tuple[str, dict[str, Any]]]] = {
    Classifier.FLOWER: _flower,
    Classifier.U32: _u32,
}
