"""netlab: a Linux network-namespace emulation lab for robot mesh networking."""

__version__ = "0.1.0"
