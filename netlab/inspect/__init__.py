"""Answers of :mod:`netlab.traces` as text, JSON and CSV, for ``netlab inspect``."""
