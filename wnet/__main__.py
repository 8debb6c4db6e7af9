"""``python -m wnet`` is the command ``wnet``."""

import sys

from wnet.cli import main

sys.exit(main())
