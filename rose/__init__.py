"""Robot services over multicast: publish once for all who listen, command by unicast, keep no connections."""

from rose.core.addressing import ServiceId
from rose.core.buffers import Deadline, Freshness, JitterBuffer, LatestValues
from rose.core.keys import KeyRing, parse_key
from rose.core.messages import Done, Refusal
from rose.core.reception import Sample
from rose.core.types import AnyMessage, Message, message
from rose.errors import AddressError, CallError, ConfigError, RoseError
from rose.program import Program, Settings
from rose.service import Command, Service
from rose.subscription import Subscription

__all__ = [
    "AddressError",
    "AnyMessage",
    "CallError",
    "Command",
    "ConfigError",
    "Deadline",
    "Done",
    "Freshness",
    "JitterBuffer",
    "KeyRing",
    "LatestValues",
    "Message",
    "Program",
    "Refusal",
    "RoseError",
    "Sample",
    "Service",
    "ServiceId",
    "Settings",
    "Subscription",
    "message",
    "parse_key",
]
