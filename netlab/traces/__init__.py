"""Questions asked of a capture, and the expectations of a scenario. Pure: a loaded :class:`Trace` in, answers out."""
