"""The errors that a person sees; every command turns them into one message and an exit code, never a traceback."""


class NetlabError(Exception):
    """Base of all errors that netlab raises on purpose; the text says what is wrong and what to do."""


class ScenarioError(NetlabError):
    """A scenario file is wrong. ``problems`` lists every mistake as ``file:line: key: what is wrong; what to do``."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class MachineError(NetlabError):
    """This machine cannot do what was asked (kernel feature, permission, tool); the text names the way out."""


class LabError(NetlabError):
    """A running lab failed: a process that could not start, a lost supervisor, an unknown node."""


class CaptureError(NetlabError):
    """A capture file cannot be written or read."""
