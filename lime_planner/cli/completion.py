"""`lime-planner completion`: commands and options at the press of the tabulator key."""

from __future__ import annotations

import argparse
from pathlib import Path

SHELLS = ("bash", "zsh")

_EPILOG = """\
examples, for this shell and for every later one:
  source <(lime-planner completion bash)
  lime-planner completion bash \\
      > ~/.local/share/bash-completion/completions/lime-planner
  lime-planner completion zsh > ~/.zfunc/_lime-planner   # ~/.zfunc in fpath
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = _EPILOG
    parser.add_argument("shell", choices=SHELLS, help="which shell")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from lime_planner.cli.main import build_parser

    parser = build_parser((), everything=True)
    _complete_files(parser)
    print(shtab.complete(parser, shell=args.shell))
    return 0


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Have file names completed where an argument is one."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _complete_files(below)
        elif action.type is Path or action.metavar == "FILE":
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
