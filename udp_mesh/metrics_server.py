"""``udp-mesh metrics``: a small HTTP server that asks the daemon at every scrape. A process of its own."""

from __future__ import annotations

from http.server import BaseHTTPRequestHandler, HTTPServer

from udp_mesh.client import Client
from udp_mesh.client_types import ClientError
from udp_mesh.metrics import render

_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class MetricsServer(HTTPServer):
    """Serves ``/metrics`` of one daemon."""

    def __init__(self, address: tuple[str, int], client: Client) -> None:
        """Listen.

        Raises:
            OSError: The address is in use, or not of this host.
        """
        self.client = client
        super().__init__(address, _Handler)


class _Handler(BaseHTTPRequestHandler):
    server: MetricsServer

    def do_GET(self) -> None:
        """Answer a scrape; 503 while the daemon does not answer."""
        if self.path.partition("?")[0] != "/metrics":
            self.send_error(404, "only /metrics is here")
            return
        try:
            text = render(self.server.client.stats()).encode()
        except ClientError as error:
            self.send_error(503, str(error))
            return
        self.send_response(200)
        self.send_header("Content-Type", _CONTENT_TYPE)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, format: str, *arguments: object) -> None:
        """Say nothing: scrapes are many."""
