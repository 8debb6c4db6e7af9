"""What the command shows of a mesh: rows, tables and graphs."""

from __future__ import annotations

import json
import random

from wnet.config import MeshConfig
from wnet.core.mesh import Member, Mesh
from wnet.views import answer, dot, table

NODES = tuple(bytes((2, 0, 0, 0, 0, number)) for number in (1, 2))
MEMBERS = tuple(bytes((2, 0, 0, 0, 1, number)) for number in (1, 2))


def pair() -> Mesh:
    """One of two nodes that have met over a wire."""
    meshes = [
        Mesh(MeshConfig(), mac, [Member(member, False, 1700)], epoch=1, rng=random.Random(1), now=0.0)
        for mac, member in zip(NODES, MEMBERS, strict=True)
    ]
    for place, mesh in enumerate(meshes):
        mesh.set_addresses([bytes((10, 240, 0, place + 1))], now=0.0)
    for step in range(300):
        now = step / 100
        for mesh, other in (meshes, meshes[::-1]):
            mesh.handle_timer(now=now)
            for out in mesh.frames_to_send(now=now):
                other.receive(0, out.frame, now=now)
    return meshes[0]


def test_every_answer_is_plain_json_and_has_text_and_a_graph() -> None:
    snapshot = pair().snapshot(now=3.0)
    told = {word: json.loads(json.dumps(answer(word, snapshot))) for word in ("topology", "links", "routes", "stats")}
    assert {told[word]["mac"] for word in told} == {"02:00:00:00:00:01"}
    assert told["routes"]["routes"][0]["destination"] == "02:00:00:00:00:02"
    assert told["stats"]["counts"]["control_sent"] > 0
    heads = {"links": "NEIGHBOUR", "routes": "DESTINATION", "topology": "FROM"}
    for word, head in heads.items():
        lines = table(word, told[word]).splitlines()
        assert lines[0].startswith(head)
        assert any("10.240.0.2" in line for line in lines[1:]), "nodes go by the addresses that they tell"
    assert '"10.240.0.1" -> "10.240.0.2"' in dot("topology", told["topology"])
    assert '"10.240.0.1" -> "10.240.0.2" [label="1 hops"]' in dot("routes", told["routes"])
    assert dot("links", told["links"]).startswith("digraph wnet_links {")
