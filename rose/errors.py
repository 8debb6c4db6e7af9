"""What rose raises on purpose. Bytes from the network never raise: they are counted by reason and dropped."""


class RoseError(Exception):
    """Base of all errors; the text says what is wrong and what to do."""


class AddressError(RoseError, ValueError):
    """A service id is malformed, or beyond the limits of its form."""


class ConfigError(RoseError):
    """A configuration is wrong; ``problems`` has every mistake as ``file:line: key: what is wrong; what to do``."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class CallError(RoseError):
    """A command was not answered in time, or its receiver refused it."""


class TypeMismatchError(RoseError):
    """A payload is of another type than the one it was to be read as."""
