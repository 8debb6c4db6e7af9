"""The project's protocols as scapy layers: frames built field by field, also such as no daemon would send.

Import a protocol's module, as in ``from netlab.scapy_layers.udp_mesh import UdpMesh``. Needs scapy.
"""

from __future__ import annotations

from importlib.util import find_spec

from netlab.errors import MachineError

if find_spec("scapy") is None:
    raise MachineError("scapy is missing: pip install 'udp-mesh-lab[scapy]'")
