"""Example services: a simulated laser, and three that use what it publishes (``topologies/rose_laser.yaml``)."""
