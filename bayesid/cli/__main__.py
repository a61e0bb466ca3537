"""``python -m bayesid.cli``."""

import sys

from bayesid.cli import main

sys.exit(main())
