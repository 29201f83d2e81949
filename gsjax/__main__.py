"""`python -m gsjax` is the command `gsjax`."""

import sys

from gsjax.cli import main

sys.exit(main())
