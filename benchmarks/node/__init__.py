"""Programs that drive the nodes from outside, for minutes or hours: soak, load, promptness, shutdown, replay, acceptance."""

import sys
from pathlib import Path

# They share the tests' harness, which is no package: it is not installed either.
sys.path.append(str(Path(__file__).resolve().parents[2] / "test" / "helpers"))
