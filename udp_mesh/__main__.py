"""``python -m udp_mesh`` is the command ``udp-mesh``."""

import sys

from udp_mesh.cli import main

sys.exit(main())
