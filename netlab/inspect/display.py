"""Which packets match a display filter of Wireshark: asked of tshark, over an export to pcapng."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from netlab.capture.export import export_pcapng
from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.errors import NetlabError
from netlab.wireshark.plugin import dissectors

_INSTALL = "sudo apt-get install tshark"


class DisplayFilterError(NetlabError):
    """tshark is missing, or does not understand the expression."""


@contextmanager
def matching(capture: Capture, expression: str) -> Iterator[Iterator[PacketRecord]]:
    """The packets that match, in the order of time; to be read inside the ``with``.

    Args:
        capture: It stays open.
        expression: As in Wireshark's filter bar: ``udp.port == 8700 && frame.len > 1000``.

    Raises:
        DisplayFilterError: tshark is not installed, or says that the expression is wrong.
    """
    tshark = find_tshark()
    with tempfile.TemporaryDirectory(prefix="netlab-display-") as folder:
        exported = Path(folder) / "packets.pcapng"
        export_pcapng(capture, exported)
        scripts = [word for path in dissectors() for word in ("-X", f"lua_script:{path}")]
        command = [tshark, "-2", "-r", str(exported), *scripts, "-Y", expression, "-T", "fields", "-e", "frame.number"]
        # A home of its own: dissectors that are installed there, too, would be registered twice.
        environment = {**os.environ, "HOME": folder, "XDG_CONFIG_HOME": folder}
        found = Path(folder) / "numbers"
        with found.open("w") as file:
            done = subprocess.run(command, stdout=file, stderr=subprocess.PIPE, text=True, check=False, env=environment)
        if done.returncode:
            raise DisplayFilterError(f"--display: {_complaint(done.stderr)}")
        with found.open() as numbers:
            yield _picked(capture, (int(line) for line in numbers if line.strip()))


def find_tshark() -> str:
    """The path of tshark.

    Raises:
        DisplayFilterError: It is not installed; says how to install it.
    """
    path = shutil.which("tshark")
    if path is None:
        raise DisplayFilterError(
            f"--display needs tshark, which is not installed here ({_INSTALL}); "
            "--node, --peer, --topic, --priority, --from and --to work without it"
        )
    return path


def _complaint(text: str) -> str:
    """What tshark says of an expression: one line, without its warnings about the user it runs as."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Running as user")]
    return lines[0].removeprefix("tshark: ") if lines else "tshark failed without a word"


def _picked(capture: Capture, numbers: Iterator[int]) -> Iterator[PacketRecord]:
    """The packets with these numbers: the export has them all, in this order, from 1 on."""
    wanted = next(numbers, None)
    for number, record in enumerate(capture.records({Kind.PACKET}), start=1):
        if wanted is None:
            return
        if number == wanted and isinstance(record, PacketRecord):
            yield record
            wanted = next(numbers, None)
