"""``python -m rose``."""

from rose.cli import main

main()
