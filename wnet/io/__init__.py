"""wnet's edges: packet sockets, the mesh interface, the control socket. All that knows the kernel is here."""
