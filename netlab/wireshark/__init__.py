"""Wireshark's view of what the lab captures: the dissectors in ``lua/``, and their installation (docs/wireshark.md)."""
