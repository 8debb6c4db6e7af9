"""How the kernel is made, as data: source package, configuration fragment, patches; and the key of the result. Pure."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass

SOURCE_PACKAGE = "linux-source-6.1"
SOURCE_TREE = "linux-source-6.1"

#: Raised by whoever changes a step of the build in a way that changes its result.
RECIPE_VERSION = 1

#: Command -> Debian package. ``ld`` and ``ar`` come with gcc.
TOOLS = {
    "gcc": "gcc",
    "make": "make",
    "flex": "flex",
    "bison": "bison",
    "bc": "bc",
    "xz": "xz-utils",
    "tar": "tar",
    "apt-get": "apt",
    "dpkg-deb": "dpkg",
}
#: Headers that have no command to look for.
HEADERS = {"libelf.h": "libelf-dev"}

_OPTION = re.compile(r"(?:# )?(CONFIG_[A-Z0-9_]+)(?:=.*| is not set)")
_COMPILED = re.compile(r"^\s+(?:CC|AS|AR|LD)\s")

#: Lines of make's output of a whole build, measured; only the progress shown depends on it.
COMPILE_STEPS = 1780


@dataclass(frozen=True, slots=True)
class Patch:
    """A textual change of one source file; the build fails if ``old`` is not there."""

    path: str
    old: str
    new: str


#: A guest process whose tracer is killed would run on, on the host, with the guest's registers: let it die instead.
PATCHES = (
    Patch(
        "arch/um/os-Linux/skas/process.c",
        r"\(void \*\) ?PTRACE_O_TRACESYSGOOD\)",
        "(void *) (PTRACE_O_TRACESYSGOOD | PTRACE_O_EXITKILL))",
    ),
)


def options(fragment: str) -> dict[str, str]:
    """Option name -> its whole line, of a fragment or of a final configuration."""
    found = {}
    for line in fragment.splitlines():
        match = _OPTION.fullmatch(line.strip())
        if match:
            found[match[1]] = line.strip()
    return found


def lost_options(fragment: str, final: str) -> list[str]:
    """Lines of the fragment that the final configuration does not hold: unknown, or a dependency is missing."""
    have = options(final)
    lost = []
    for name, line in options(fragment).items():
        if have.get(name) != line and not (line.endswith("is not set") and name not in have):
            lost.append(line)
    return lost


def fragment_hash(fragment: str) -> str:
    """Of what the fragment says; comments and order do not count."""
    return hashlib.sha256("\n".join(sorted(options(fragment).values())).encode()).hexdigest()


def key(source_version: str, fragment: str, recipe: int = RECIPE_VERSION) -> str:
    """The name under which a built kernel is cached."""
    text = f"{source_version}\n{fragment_hash(fragment)}\n{recipe}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def apply_patch(patch: Patch, text: str) -> str:
    """The patched text; a file that is patched already comes back as it is.

    Raises:
        ValueError: What is to be replaced is not there.
    """
    if patch.new in text:
        return text
    changed, count = re.subn(patch.old, patch.new.replace("\\", "\\\\"), text)
    if count == 0:
        raise ValueError(f"{patch.path}: nothing matches {patch.old!r}; the source has changed, mend the recipe")
    return changed


class Progress:
    """Guesses how far make is from the lines that it prints."""

    def __init__(self, steps: int = COMPILE_STEPS) -> None:
        self._steps = steps
        self._seen = 0

    def line(self, text: str) -> None:
        """Take one line of make's output."""
        self._seen += bool(_COMPILED.match(text))

    @property
    def percent(self) -> int:
        """0 to 99: it is a guess, so never done before it is done."""
        return min(99, self._seen * 100 // self._steps)
