"""`python -m melp_warp`: the same as `melp-warp`."""

import sys

from melp_warp.cli import main

sys.exit(main())
