"""The pure part of rose: addresses, frames, types, losses, keys. No socket, no clock, no event loop."""
