"""What is drawn of a lab while it is recorded: the map, the nodes where they are, the links between them, their mesh.

Knows what was recorded so far, nothing of files and clocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from netlab.capture import foxglove
from netlab.capture.link_scene import LinkScene
from netlab.capture.mesh_scene import MeshScene
from netlab.capture.mesh_view import MeshView

if TYPE_CHECKING:
    from netlab.capture.topics import Topics

NODES_TOPIC = "/nodes/scene"
LINKS_TOPIC = "/links/scene"
MESH_TOPIC = "/mesh/scene"


class Drawing:
    """Turns the lab's own messages into scenes on further topics."""

    def __init__(self, topics: Topics, mesh: MeshView) -> None:
        self._topics = topics
        self._links = LinkScene()
        self._mesh = MeshScene(mesh)
        self._nodes: list[str] = []

    def take(self, topic: str, payload: Mapping[str, object], t_ns: int) -> None:
        """Record what one message of the lab looks like."""
        if topic == "/map":
            self._topics.scene(topic, foxglove.scene_schema, t_ns, foxglove.encode_map(payload, t_ns))
        elif topic == "/poses":
            self._poses(topic, payload, t_ns)
        elif topic == "/links":
            self._links.take_link(payload)

    def draw(self, now_ns: int) -> None:
        """Record the links and the mesh as they are now, if anything about them changed."""
        for topic, data in (
            (LINKS_TOPIC, self._links.message(now_ns)),
            (MESH_TOPIC, self._mesh.message(now_ns)),
        ):
            if data is not None:
                self._topics.scene(topic, foxglove.scene_schema, now_ns, data)

    def _poses(self, topic: str, payload: Mapping[str, object], t_ns: int) -> None:
        t_s, t0_ns = payload.get("t_s"), self._topics.t0_ns
        stamp_ns = t_ns if t0_ns is None or not isinstance(t_s, int | float) else t0_ns + round(t_s * 1e9)
        self._topics.scene(topic, foxglove.transforms_schema, t_ns, foxglove.encode_poses(payload, stamp_ns))
        self._links.take_poses(payload)
        self._mesh.take_poses(payload)
        nodes = payload.get("nodes")
        if isinstance(nodes, list) and nodes != self._nodes:
            self._nodes = nodes
            self._topics.scene(NODES_TOPIC, foxglove.scene_schema, t_ns, foxglove.encode_nodes(nodes, t_ns))
