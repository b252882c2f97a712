"""`python -m jaxrl_tab` is the command line."""

import sys

from jaxrl_tab.cli import main

sys.exit(main())
