"""What a service's own code looks like: a class with settings and one coroutine, run by ``rose.runner``.

class Laser(rose.Program):
    class Settings(rose.Settings):
        rate_hz: float = 10.0

    async def run(self) -> None:
        while True:
            self.service.publish(scan())
            await asyncio.sleep(1.0 / self.settings.rate_hz)
"""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import msgspec

from rose.errors import RoseError
from rose.service import Service


class Settings(msgspec.Struct, forbid_unknown_fields=True):
    """Base of a program's settings: fields with types and defaults; unknown names and wrong values are refused."""


class Program(ABC):
    """One service's code. It may be started again with other settings at any time."""

    Settings: ClassVar[type[msgspec.Struct]] = Settings

    def __init__(self, service: Service, settings: Any) -> None:
        """``service`` is started already; ``settings`` are of this class's own type."""
        self.service = service
        self.settings = settings

    @abstractmethod
    async def run(self) -> None:
        """Do the work until cancelled; returning ends the service."""


def load_program(where: str) -> type[Program]:
    """Import ``MODULE:CLASS``.

    Raises:
        RoseError: There is no such module or class, or it is no program.
    """
    module, _, name = where.partition(":")
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError as error:
        raise RoseError(f"{where}: {error}") from None
    if not (isinstance(found, type) and issubclass(found, Program)):
        raise RoseError(f"{where}: there is no class {name} in {module} that derives from rose.Program")
    return found


def settings_of(cls: type[Program], values: dict[str, object]) -> msgspec.Struct:
    """Return plain values as a program's settings.

    Raises:
        RoseError: An unknown name or a wrong value; says which.
    """
    try:
        return msgspec.convert(values, cls.Settings, strict=False)
    except msgspec.ValidationError as error:
        raise RoseError(f"settings of {cls.__name__}: {error}") from None
