"""Prometheus text and its server."""

from __future__ import annotations

import threading
import urllib.error
import urllib.request
from typing import Any

import pytest

from udp_mesh.client_types import ClientError
from udp_mesh.metrics import render
from udp_mesh.metrics_server import MetricsServer

STATS: dict[str, object] = {
    "name": 'we "rove"\\',
    "counters": {"messages_acked": 12, "queued_bytes": 5},
    "queues": {"map": 3},
    "stored": {},
    "peers": [{"name": "base", "online": True, "srtt_s": None, "rate_bps": 1.5e6, "queued_messages": 2}],
}


class Daemon:
    """A client whose daemon may be away."""

    is_there = True

    def stats(self) -> dict[str, object]:
        if not self.is_there:
            raise ClientError("no daemon")
        return STATS


def test_every_number_has_its_type_and_labels() -> None:
    lines = render(STATS).splitlines()
    node = r'node="we \"rove\"\\"'
    assert f"udp_mesh_messages_acked_total{{{node}}} 12" in lines
    assert f"udp_mesh_queued_bytes{{{node}}} 5" in lines
    assert f'udp_mesh_topic_queues{{{node},topic="map"}} 3' in lines
    assert f'udp_mesh_peer_online{{{node},peer="base"}} 1' in lines
    assert f'udp_mesh_peer_rate_bps{{{node},peer="base"}} 1.5e+06' in lines
    assert not any("srtt" in line or "topic_stored" in line for line in lines), "what is not known is left out"
    names = [line.split()[2] for line in lines if line.startswith("# TYPE")]
    assert len(names) == len(set(names))


@pytest.fixture
def server() -> Any:
    daemon: Any = Daemon()
    with MetricsServer(("127.0.0.1", 0), daemon) as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def get(server: MetricsServer, path: str) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{server.server_port}{path}", timeout=5.0) as answer:
        return str(answer.read().decode())


def test_a_scrape_asks_the_daemon_and_its_absence_is_503(server: MetricsServer) -> None:
    assert "udp_mesh_messages_acked_total" in get(server, "/metrics")
    for path, is_there, code in (("/other", True, 404), ("/metrics", False, 503)):
        server.client.is_there = is_there  # type: ignore[attr-defined]
        with pytest.raises(urllib.error.HTTPError) as caught:
            get(server, path)
        with caught.value:
            assert caught.value.code == code
