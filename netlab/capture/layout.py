"""A layout for Foxglove that fits a run: map with links, latencies, states of links, the acts, a log. Values only.

Made for the nodes and streams of the run; it goes into the capture as an attachment, and into the docs.
Source of the keys: layouts as Foxglove exports them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

LAYOUT_NAME = "foxglove-layout.json"
_PATHS_MAX = 12
_SCENES = ("/map", "/links/scene", "/mesh/scene", "/nodes/scene")


def foxglove_layout(metadata: Mapping[str, str]) -> dict[str, object]:
    """Return the layout for the run that ``metadata`` (the record ``netlab.run``) tells of."""
    streams = json.loads(metadata.get("streams", "[]"))
    return {
        "configById": {
            "3D!map": _map(),
            "Plot!latency": _plot("Latency, s", _latency_paths(streams)),
            "StateTransitions!links": _states([*_link_paths(streams), ("/timeline.label", "acts")]),
            "RosOut!log": {"searchTerms": [], "minLogLevel": 1, "topicToRender": _log_topic(streams)},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": "3D!map",
            "second": {
                "direction": "column",
                "first": "Plot!latency",
                "second": {
                    "direction": "column",
                    "first": "StateTransitions!links",
                    "second": "RosOut!log",
                    "splitPercentage": 55,
                },
                "splitPercentage": 45,
            },
            "splitPercentage": 58,
        },
    }


def layout_file(metadata: Mapping[str, str]) -> bytes:
    """Return the layout as the file that Foxglove imports."""
    return (json.dumps(foxglove_layout(metadata), indent=1) + "\n").encode()


def _map() -> dict[str, object]:
    grid = {
        "layerId": "foxglove.Grid",
        "label": "Grid",
        "visible": True,
        "size": 400,
        "divisions": 40,
        "frameId": "map",
    }
    return {
        "cameraState": {"perspective": False, "distance": 250, "phi": 0, "thetaOffset": 0, "target": [60, 20, 0]},
        "followMode": "follow-none",
        "followTf": "map",
        "scene": {"transforms": {"showLabel": False, "axisScale": 0, "lineWidth": 0}},
        "topics": {topic: {"visible": True} for topic in _SCENES},
        "layers": {"grid": grid},
        "foxglovePanelTitle": "Tunnels, nodes, links and mesh",
    }


def _plot(title: str, paths: Sequence[tuple[str, str]]) -> dict[str, object]:
    shown = [
        {"value": value, "label": label, "enabled": True, "timestampMethod": "receiveTime", "showLine": False}
        for value, label in paths
    ]
    return {
        "foxglovePanelTitle": title,
        "paths": shown,
        "xAxisVal": "timestamp",
        "minYValue": 0,
        "showLegend": True,
        "legendDisplay": "top",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
    }


def _latency_paths(streams: Sequence[Mapping[str, object]]) -> list[tuple[str, str]]:
    """One series per stream, the most urgent ones if they are many."""
    urgent = sorted(streams, key=lambda stream: str(stream["priority"]).zfill(3))[:_PATHS_MAX]
    return [
        (
            f"/{stream['destination']}/traffic/received{{stream=={stream['stream']}}}.latency_s",
            f"{stream['topic']} {stream['source']}→{stream['destination']}",
        )
        for stream in urgent
    ]


def _link_paths(streams: Sequence[Mapping[str, object]]) -> list[tuple[str, str]]:
    """The links between the ends of streams, one direction each."""
    pairs = dict.fromkeys((str(stream["source"]), str(stream["destination"])) for stream in streams)
    return [
        (f'/links{{from=="{source}"}}{{to=="{destination}"}}.state', f"{source}→{destination}")
        for source, destination in list(pairs)[:_PATHS_MAX]
    ]


def _states(paths: Sequence[tuple[str, str]]) -> dict[str, object]:
    shown = [{"value": value, "label": label, "timestampMethod": "receiveTime"} for value, label in paths]
    return {"foxglovePanelTitle": "Links and acts", "paths": shown, "isSynced": True}


def _log_topic(streams: Sequence[Mapping[str, object]]) -> str:
    """A log panel shows one topic: that of the most urgent stream's source."""
    urgent = min(streams, key=lambda stream: str(stream["priority"]).zfill(3), default=None)
    return f"/{urgent['source']}/log/udp_mesh" if urgent is not None else ""
