"""Live status of a run: a table that renews itself on a terminal, a line now and then elsewhere."""

from __future__ import annotations

from types import TracebackType
from typing import Any, TextIO

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from netlab.scenario.model import Scenario

_LINE_EVERY_S = 2.0
_STATE_STYLE = {"up": "green", "outage": "red", "no_carrier": "red", "out_of_range": "yellow"}


class Status:
    """Shows what :meth:`Lab.status` says. Use as a context manager around the run."""

    def __init__(self, scenario: Scenario, stream: TextIO) -> None:
        self._scenario = scenario
        self._streams = scenario.streams()
        self._console = Console(file=stream)
        self._live = Live(console=self._console, auto_refresh=False) if self._console.is_terminal else None
        self._next_line_s = 0.0
        self._told: set[str] = set()

    def __enter__(self) -> Status:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def ready(self, name: str, status: dict[str, Any]) -> None:
        """Say that the lab is up."""
        self._console.print(
            f"{name}: {len(status['nodes'])} nodes up in {status['bring_up_s']:.2f} s, engine {status['engine']}, "
            f"seed {status['seed']}, {status['duration_s']:g} s to run",
            highlight=False,
        )

    def update(self, status: dict[str, Any]) -> None:
        """Show the present state."""
        for text in (*status["failures"], *status["problems"], *status["notices"]):
            if text not in self._told:
                self._told.add(text)
                headline = text.splitlines()[0]  # the whole story stands in the final report
                self._console.print(headline, style="red", highlight=False, markup=False, soft_wrap=True)
        if self._live is not None:
            self._live.update(self._table(status), refresh=True)
            return
        t_s = status["t_s"] if status["t_s"] is not None else 0.0
        if t_s >= self._next_line_s or status["phase"] == "finished":
            self._next_line_s = t_s + _LINE_EVERY_S
            self._console.print(self._line(status), highlight=False, soft_wrap=True)

    def _line(self, status: dict[str, Any]) -> str:
        t_s = status["t_s"] or 0.0
        down = sorted({f"{row['from']}-{row['to']}" for row in status["links"] if row["state"] != "up"})
        parts = [f"t={min(t_s, status['duration_s']):5.1f}s {status['phase']}"]
        for stream in self._streams[:8]:
            sent, delivered, latency = self._figures(status, stream.index)
            parts.append(f"{stream.topic} {stream.source}>{stream.destination} {delivered}/{sent} {latency}")
        if len(self._streams) > 8:
            parts.append(f"... {len(self._streams)} streams")
        if down:
            parts.append("down: " + " ".join(down[:6]))
        return "  ".join(parts)

    def _table(self, status: dict[str, Any]) -> Group:
        t_s = max(0.0, status["t_s"] or 0.0)
        duration_s = status["duration_s"]
        done = min(1.0, t_s / duration_s)
        bar = Text(f" {status['name']}  {status['phase']}  {min(t_s, duration_s):.1f} / {duration_s:g} s  ")
        bar.append("━" * round(30 * done), style="cyan")
        bar.append("━" * (30 - round(30 * done)), style="grey37")
        return Group(bar, self._stream_table(status), self._link_line(status), self._process_line(status))

    def _stream_table(self, status: dict[str, Any]) -> Table:
        table = Table(box=None, pad_edge=True, header_style="dim")
        for name, justify in (("stream", "left"), ("priority", "right"), ("sent", "right"), ("delivered", "right")):
            table.add_column(name, justify="left" if justify == "left" else "right")
        table.add_column("latency p50", justify="right")
        for stream in sorted(self._streams, key=lambda stream: stream.priority)[:20]:
            sent, delivered, latency = self._figures(status, stream.index)
            name = f"{stream.source} > {stream.destination}  {stream.topic}"
            table.add_row(name, str(stream.priority), str(sent), str(delivered), latency)
        return table

    @staticmethod
    def _link_line(status: dict[str, Any]) -> Text:
        line = Text(" links  ", style="dim")
        both: dict[frozenset[str], str] = {}
        for row in status["links"]:
            pair = frozenset((row["from"], row["to"]))
            both[pair] = row["state"] if both.get(pair, "up") == "up" else both[pair]
        for pair, state in list(both.items())[:24]:
            line.append(f"{'-'.join(sorted(pair))} ", style=_STATE_STYLE.get(state, "red"))
        return line

    @staticmethod
    def _process_line(status: dict[str, Any]) -> Text:
        line = Text(" processes  ", style="dim")
        bad = [p for p in status["processes"] if p["state"] == "exited" and p["exit_status"]]
        good = sum(p["state"] == "ready" for p in status["processes"])
        line.append(f"{good} running", style="green")
        for process in bad[:8]:
            line.append(f"  {process['node']}/{process['process']} exit {process['exit_status']}", style="red")
        return line

    @staticmethod
    def _figures(status: dict[str, Any], index: int) -> tuple[int, int, str]:
        row = status["streams"].get(str(index), {})
        latency = row.get("latency_p50_s")
        return row.get("sent", 0), row.get("delivered", 0), "-" if latency is None else f"{latency * 1e3:.1f} ms"
