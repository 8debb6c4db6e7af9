"""wnet: a layer-2 mesh that routes by link quality and knows multicast (docs/wnet.md)."""
