"""`lime-planner compile`: compile everything that is compiled, so that no plan waits for it."""

from __future__ import annotations

import argparse

_EPILOG = """\
What plans first would do it too. It takes about a minute on two free cores,
once after an installation or an update.

example:
  lime-planner compile
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments: there are none."""
    parser.epilog = _EPILOG


def run(args: argparse.Namespace) -> int:
    """Compile."""
    from lime_planner.core.cache_folder import cache_root
    from lime_planner.core.kernel_cache import all_compiled
    from lime_planner.output.console import compile_first

    began = compile_first()
    if not all_compiled():
        return 1
    print(f"{'compiled' if began else 'everything is compiled already'}: {cache_root()}")
    return 0
