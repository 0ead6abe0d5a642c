"""`python -m nnql_bullet`."""

import sys

from nnql_bullet.cli import main

sys.exit(main())
