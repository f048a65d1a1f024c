"""`python -m lime_planner` is `lime-planner`."""

from __future__ import annotations

import sys

from lime_planner.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
