"""``python -m pipeline``: the program ``polhode``."""

import sys

from pipeline.cli import main

sys.exit(main())
