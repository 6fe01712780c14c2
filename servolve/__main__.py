"""`python -m servolve`: the command line."""

import sys

from servolve.cli import main

sys.exit(main())
