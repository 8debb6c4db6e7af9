"""Sockets of rose: UDP with multicast, and udp_mesh for services that ask for delivery."""
