"""The messages that rose itself exchanges."""

from __future__ import annotations

from rose.core.types import Message, message


@message("rose/done")
class Done(Message, array_like=True, frozen=True):
    """The answer to a command that has nothing else to say."""


@message("rose/refusal")
class Refusal(Message, array_like=True, frozen=True):
    """Why a command was not carried out."""

    reason: str


@message("rose/configure")
class Configure(Message, array_like=True, frozen=True):
    """To a service: take these settings from now on. Answered by :class:`Done`, or refused with what is wrong."""

    settings: dict[str, object]


@message("rose/configure_host")
class ConfigureHost(Message, array_like=True, frozen=True):
    """To a Service Manager: run these services and no others. ``version`` names the configuration.

    ``services`` are plain values with the keys of a configuration file's services.
    """

    version: str
    services: list[dict[str, object]]


@message("rose/service_state")
class ServiceState(Message, array_like=True, frozen=True):
    """One service of a host. ``state``: starting, running, failed (``detail`` says why) or ended."""

    sid: str
    name: str
    state: str
    restarts: int = 0
    detail: str = ""


@message("rose/host_state")
class HostState(Message, array_like=True, frozen=True):
    """What a Service Manager announces once a second."""

    version: str
    services: list[ServiceState]


@message("rose/ask_host")
class AskHost(Message, array_like=True, frozen=True):
    """To a Service Manager: answer with your :class:`HostState`."""
