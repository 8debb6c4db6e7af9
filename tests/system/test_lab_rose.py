"""Services on hosts of their own: with the network cut, over IPv6, out of reach and back, and delivered by udp_mesh."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator

from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab

TWO = {"name": "rose", "duration": "1s", "nodes": {"a": {}, "b": {}}, "links": [{"between": ["a", "b"]}]}
#: Looks at what a program has said so far; each takes some milliseconds.
TRIES = 5000
LASER = 'name: laser, id: 0.1, run: "rose.examples.laser:Laser", settings: {rate_hz: 50, beams: 8}'


@contextlib.contextmanager
def services(lab: Lab, node: str, address: str, service: str) -> Iterator[None]:
    """A host's Service Manager in a node, with all its services running; what they say is in /tmp/log."""
    file = f"host: {address}\nservices:\n  - {{{service}}}\n"
    lab.exec(node, "sh", "-c", "cat > /tmp/host.yaml", text=file)
    lab.exec(node, "mkfifo", "/tmp/ready")
    command = "exec rose run /tmp/host.yaml --ready-fd 9 9>/tmp/ready 2>/tmp/log"
    with contextlib.closing(lab.spawn(node, "sh", "-c", command)):
        assert lab.exec(node, "cat", "/tmp/ready", timeout_s=60.0).stdout == "ready\n"
        yield


def echoed(lab: Lab, node: str, service: str, host: str, *, count: int = 1) -> list[dict[str, object]]:
    done = lab.exec(node, "rose", "echo", service, "--host", host, "--count", str(count), "--json", timeout_s=60.0)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_host_is_fully_up_with_the_network_cut_and_heard_when_it_is_back(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    lab.exec("a", "ip", "link", "set", "eth0", "down")
    with services(lab, "a", "10.1.0.1", LASER):
        state = lab.exec("a", "rose", "call", "10.1.0.1/0.0", "rose/ask_host", "--host", "10.1.0.1", timeout_s=60.0)
        assert [service["state"] for service in json.loads(state.stdout)["services"]] == ["running"], state.stderr
        lab.exec("a", "ip", "link", "set", "eth0", "up")
        (sample,) = echoed(lab, "b", "10.1.0.1/0.1", "10.1.0.2")
        assert sample["sender"] == "10.1.0.1/0.1"


def test_a_host_whose_address_comes_after_its_services(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    with services(lab, "a", "10.1.0.77", LASER):
        lab.exec("a", "ip", "address", "add", "10.1.0.77/24", "dev", "eth0")
        (sample,) = echoed(lab, "b", "10.1.0.77/0.1", "10.1.0.2")
        assert sample["sender"] == "10.1.0.77/0.1"


def test_over_ipv6(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    for node, number in (("a", 1), ("b", 2)):
        lab.exec(node, "sh", "-c", "echo 0 > /proc/sys/net/ipv6/conf/eth0/disable_ipv6")
        added = lab.exec(node, "ip", "address", "add", f"fd00::{number}/64", "dev", "eth0", "nodad")
        assert added.returncode == 0, added.stderr
    with services(lab, "a", '"fd00::1"', LASER.replace("id: 0.1", "id: 500.2000")):
        (sample,) = echoed(lab, "b", "fd00::1/500.2000", "fd00::2")
        assert sample["sender"] == "fd00::1/500.2000"
        call = ("rose", "call", "fd00::1/500.2000", "example/set_rate", "[20.0]", "--host", "fd00::2")
        done = lab.exec("b", *call, timeout_s=60.0)
        assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr


def test_a_subscriber_that_was_out_of_reach_goes_on_without_any_action(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    with services(lab, "a", "10.1.0.1", LASER):
        words = ("rose", "echo", "10.1.0.1/0.1", "--host", "10.1.0.2", "--json")
        with contextlib.closing(lab.spawn("b", "sh", "-c", f"exec {' '.join(words)} > /tmp/heard")):
            lines_after(lab, 5)
            lab.outage("a", "b", active=True)
            while not lab.exec(
                "a", "rose", "call", "10.1.0.1/0.1", "example/set_rate", "[40.0]", "--host", "10.1.0.1", timeout_s=60.0
            ).stdout:
                pass
            before = lines_after(lab, 0)
            lab.outage("a", "b", active=False)
            after = lines_after(lab, len(before) + 5)
        gaps = [json.loads(line)["lost_before"] for line in after]
        assert max(gaps) > 0  # the outage is seen
        assert gaps[-1] == 0  # and over


def lines_after(lab: Lab, count: int) -> list[str]:
    """What was heard so far, at least ``count`` lines."""
    for _ in range(TRIES):
        lines = lab.exec("b", "cat", "/tmp/heard").stdout.splitlines()
        if len(lines) >= count:
            return lines[:-1] if lines and not lines[-1].endswith("}") else lines
    raise AssertionError(f"only {len(lines)} lines were heard")


def test_udp_mesh_delivers_what_multicast_would_lose(make_lab: MakeLab) -> None:
    lossy = {
        **TWO,
        "nodes": {"a": {"processes": ["udp_mesh"]}, "b": {"processes": ["udp_mesh"]}},
        "links": [{"between": ["a", "b"], "loss": "30%"}],
    }
    lab = make_lab(lossy)
    assert any('"online": true' in lab.exec("b", "udp-mesh", "peers", "--json").stdout for _ in range(50))
    laser = LASER + ", transport: udp_mesh, offline: store"
    display = 'name: display, id: 0.2, run: "rose.examples.display:Display", transport: udp_mesh, '
    display += "settings: {laser: 10.1.0.1/0.1, every_s: 0.5}"
    with services(lab, "b", "10.1.0.2", display), services(lab, "a", "10.1.0.1", laser):
        heard = display_lines(lab, until=lambda lines: lines[-1][0] >= 100)
        calm = ("rose", "call", "10.1.0.1/0.1", "example/set_rate", "[0.1]", "--host", "10.1.0.1")
        assert lab.exec("a", *calm, timeout_s=60.0).returncode == 0
        most = len(heard) + 30  # what is lost for good would stay so; what is being sent again has time to come
        heard = display_lines(lab, until=lambda lines: lines[-1][1] == 0 or len(lines) > most)
        assert heard[-1][1] == 0


def display_lines(lab: Lab, *, until: Callable[[list[tuple[int, int]]], bool]) -> list[tuple[int, int]]:
    """What the display has said so far: scans, and how many are missing."""
    for _ in range(TRIES):
        said = re.findall(r"(\d+) scans, (\d+) lost", lab.exec("b", "cat", "/tmp/log").stdout)
        lines = [(int(scans), int(lost)) for scans, lost in said]
        if lines and until(lines):
            return lines
    raise AssertionError(f"the display says no more: {lines[-1:]}")
