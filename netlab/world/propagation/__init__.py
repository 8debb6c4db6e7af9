"""Propagation models: how much of a radio's power is lost on the way. One module per model, found by name."""
