"""Runs the command as `python -m drake_nonstop.cli`."""

import sys

from drake_nonstop.cli.main import main

sys.exit(main())
