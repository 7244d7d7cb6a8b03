"""``python -m polhode``: the program ``polhode``."""

import sys

from polhode.cli.main import main

sys.exit(main())
