"""The interactive lab: a full-screen terminal application over :mod:`netlab.live` and :mod:`netlab.lab`."""
