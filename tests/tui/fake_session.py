"""A lab that only exists for the screen: it notes what is asked of it, and records what it is told to."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from netlab.capture.records import JsonRecord, Record, kind_of
from netlab.errors import LabError
from netlab.tui.session import Verdict

T0_NS = 1_800_000_000_000_000_000


class FakeSession:
    """Three nodes in a tunnel."""

    def __init__(self, path: Path) -> None:
        self.title = path.stem
        self.carriers = {"relay": "robot"}
        self.files: list[tuple[str, Path]] = []
        self.acts: list[dict[str, Any]] = []
        self.refuse: str | None = None
        self.held = False
        self.phase = "running"
        self.saved: list[Path] = []
        self.closed = False
        self._news: list[Record] = []

    def start(self) -> None:
        """Everybody is there, all links are up."""
        self.say("/map", tunnels=[{"name": "adit", "path": [[0, 0], [100, 0]], "width_m": 4}])
        places = {"base": (0, 0), "robot": (60, 0), "relay": (60, 0)}
        poses = [{"position": {"x": x, "y": y, "z": 0}} for x, y in places.values()]
        self.say("/poses", nodes=list(places), poses=poses, active=[True, True, False], t_s=0.0)
        for a, b in (("base", "robot"), ("robot", "base")):
            self.link(a, b, "up")

    def say(self, topic: str, at_s: float = 1.0, **payload: Any) -> None:
        """Have something recorded."""
        node = topic.split("/")[1] if topic.count("/") > 1 else ""
        self._news.append(JsonRecord(T0_NS + round(at_s * 1e9), kind_of(topic), topic, node, payload))

    def link(self, a: str, b: str, state: str) -> None:
        """Have a link's state recorded."""
        self.say("/links", **{"segment": "radio", "from": a, "to": b, "state": state})

    def metadata(self) -> Mapping[str, str]:
        """Who is there."""
        ports = [{"node": name} for name in ("base", "robot", "relay")]
        streams = [{"stream": 0, "source": "robot", "destination": "base", "topic": "telemetry", "priority": 1}]
        told = {"name": self.title, "engine": "air", "t0_ns": str(T0_NS)}
        return {**told, "ports": json.dumps(ports), "streams": json.dumps(streams)}

    def records(self) -> list[Record]:
        """What is new."""
        news, self._news = self._news, []
        return news

    def status(self) -> Mapping[str, Any]:
        """As a supervisor would say it."""
        names = ("base", "robot")
        rows = [{"node": name, "process": "udp_mesh", "state": "ready", "exit_status": None} for name in names]
        return {
            "phase": self.phase,
            "t_s": 3.0,
            "end_s": 60.0,
            "held": self.held,
            "recording": "captures/x.mcap",
            "undo": None,
            "processes": rows,
            "coming": [{"at_s": 20.0, "kind": "outage", "label": "outage base-robot begins"}],
            "failures": [],
            "problems": [],
            "notices": [],
        }

    def act(self, do: str, **values: Any) -> Mapping[str, Any]:
        """Note it, and let it take effect as far as the screen can tell."""
        if self.refuse is not None:
            raise LabError(self.refuse)
        self.acts.append({"do": do, **values})
        if do in ("hold", "resume"):
            self.held = do == "hold"
        if do == "outage":
            a, b = values["between"]
            for pair in ((a, b), (b, a)):
                self.link(*pair, "outage" if values["active"] else "up")
        return {"ok": True, "labels": ["outage base-robot begins"]} if do == "step" else {"ok": True}

    def save(self, path: Path) -> tuple[str, ...]:
        """Note where to."""
        self.saved.append(path)
        return ()

    def shell(self, node: str) -> None:
        """Nothing to see."""

    def judge(self) -> Verdict:
        """A verdict, in a line that is wider than a narrow panel."""
        return Verdict("expectations\n  met      everything that was hoped for, and a bit more", "the whole report")

    def close(self) -> None:
        """Note it."""
        self.closed = True
