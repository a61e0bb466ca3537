"""``python -m bayesid``: the command line."""

import sys

from bayesid.cli import main

sys.exit(main())
