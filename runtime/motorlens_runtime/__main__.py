"""`python -m motorlens_runtime` is `motorlens`."""

import sys

from motorlens_runtime.cli import main

sys.exit(main())
