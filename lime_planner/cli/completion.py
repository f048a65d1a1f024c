"""`lime-planner completion`: commands and options at the press of the tabulator key."""

from __future__ import annotations

import argparse
from pathlib import Path

SHELLS = ("bash", "zsh")
_COMPLETER = "_lime_planner_parameters"

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
    _complete_values(parser)
    print(shtab.complete(parser, shell=args.shell, preamble=_preamble()[args.shell]))
    return 0


def _preamble() -> dict[str, str]:
    """Return, for each shell, the function that completes the parameters of `--set`, with their values where these are few."""
    from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS

    words = []
    for parameter in (*PARAMETERS.values(), *NODE_PARAMETERS.values()):
        values = parameter.choices or (("true", "false") if parameter.kind is bool else ())
        words += [f"{parameter.name}={value}" for value in values] or [f"{parameter.name}="]
    bash = f"""{_COMPLETER}() {{
  compopt -o nospace 2>/dev/null
  compgen -W {" ".join(words)!r} -- "$1"
}}"""
    zsh = f"""{_COMPLETER}() {{
  local words=({" ".join(words)})
  compadd -S '' -- "${{words[@]}}"
}}"""
    return {"bash": bash, "zsh": zsh}


def _complete_values(parser: argparse.ArgumentParser) -> None:
    """Have file names completed where an argument is one, and parameters after `--set`."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _complete_values(below)
        elif "--set" in action.option_strings:
            action.complete = {shell: _COMPLETER for shell in SHELLS}  # type: ignore[attr-defined]
        elif action.type is Path or action.metavar == "FILE":
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
