"""udp_mesh: discovery and reliable, prioritised messaging between robots over plain UDP."""

__version__ = "0.1.0"
