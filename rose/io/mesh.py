"""rose over udp_mesh: the same datagrams, delivered by this node's udp_mesh daemon.

For services that want what udp_mesh has and multicast does not: every message arrives, in the order of urgency, and
waits while its receiver is away. It costs one transmission for every node that udp_mesh has heard, whether somebody
listens there or not. The datagrams travel as messages of the topics ``rose/SID`` (publications) and ``rose/to/SID``
(commands). Within a host they go as with UDP, for a daemon has no echo: multicast with no hop left never leaves.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from rose.core.addressing import ServiceId
from rose.errors import RoseError
from rose.io.transport import OnDatagram
from rose.io.udp import UdpTransport
from udp_mesh.client_async import AsyncClient
from udp_mesh.client_types import ClientError, PublishOptions

LEARN_S = 1.0
_DATAGRAM_BYTES = 60_000
_ALL = "all"


class MeshTransport(UdpTransport):
    """See the module's text."""

    datagram_bytes = _DATAGRAM_BYTES

    def __init__(self, *, priority: int = 5, offline: str = "discard", socket_path: str | None = None) -> None:
        """Choose what udp_mesh is asked for.

        Args:
            priority: 0..255, lower is more urgent.
            offline: ``discard``, ``latest`` or ``store``: what becomes of messages to nodes that are away.
            socket_path: The daemon's; its default if None.
        """
        super().__init__(hops=0)
        self._options = PublishOptions(priority=priority, offline=offline, reliability="reliable")
        self._client = AsyncClient(socket_path)
        self._tasks: list[asyncio.Task[None]] = []
        self._names: dict[str, str] = {}  # of peers, by address

    async def open(self, sid: ServiceId, on_datagram: OnDatagram) -> None:
        """See :meth:`Transport.open`."""
        await super().open(sid, on_datagram)
        try:
            await self._client.__aenter__()
        except ClientError as error:
            await super().close()
            raise RoseError(f"{sid}: {error}") from None
        await self._client.subscribe(f"rose/to/{sid}")
        self._tasks = [asyncio.create_task(self._take()), asyncio.create_task(self._learn())]

    async def close(self) -> None:
        """See :meth:`Transport.close`."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._client.close()
        await super().close()

    def publish(self, datagrams: Sequence[bytes]) -> None:
        """See :meth:`Transport.publish`."""
        super().publish(datagrams)
        for name in sorted(set(self._names.values())):  # one by one: what is for all at once is not acknowledged
            self._hand_over(f"rose/{self._sid}", datagrams, name)

    def send(self, to: ServiceId, datagrams: Sequence[bytes], *, local: bool = False) -> None:
        """See :meth:`Transport.send`."""
        if local or to.host == self._sid.host:
            super().send(to, datagrams, local=True)
        else:
            self._hand_over(f"rose/to/{to}", datagrams, self._names.get(str(to.host), _ALL))

    def join(self, sender: ServiceId) -> None:
        """See :meth:`Transport.join`."""
        if sender.host == self._sid.host:
            super().join(sender)
        else:
            self._tasks.append(asyncio.create_task(self._client.subscribe(f"rose/{sender}")))

    def _hand_over(self, topic: str, datagrams: Sequence[bytes], to: str) -> None:
        for datagram in datagrams:
            try:
                self._client.publish(topic, datagram, to=to, **self._options)
            except ClientError:
                self.unsent += 1

    async def _take(self) -> None:
        async for message in self._client:
            self._on_datagram(bytes(message.payload), False)

    async def _learn(self) -> None:
        """Know the nodes and their addresses: publications go to each, a command to one."""
        while True:
            for peer in await self._client.peers():
                addresses = {peer.address, *(path.address for path in peer.paths)}
                self._names |= {address.rpartition(":")[0].strip("[]"): peer.name for address in addresses}
            await asyncio.sleep(LEARN_S)
