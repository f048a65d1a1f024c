"""`lime-planner parameters`: the one table of parameters, for reading or as documentation."""

from __future__ import annotations

import argparse
from typing import Any

from lime_planner.parameters import NODE_PARAMETERS, PARAMETERS, Parameter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.epilog = "examples:\n  lime-planner parameters stem\n  lime-planner parameters --markdown"
    parser.add_argument("pattern", nargs="?", default="", metavar="TEXT", help="only those whose name or description holds this text")
    parser.add_argument("--markdown", action="store_true", help="as a Markdown table")


def _value(value: Any) -> str:
    return repr(value) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)


def _markdown(title: str, rows: list[Parameter]) -> str:
    lines = [f"### {title}", "", "| name | default | unit | range | meaning |", "|---|---|---|---|---|"]
    lines += [f"| `{p.name}` | `{_value(p.default)}` | {p.unit} | {p.range_text} | {p.description} |" for p in rows]
    return "\n".join(lines) + "\n"


def run(args: argparse.Namespace) -> int:
    """Print the parameters."""
    from rich.text import Text

    from lime_planner.viewer.tables import console

    out, found = console(), 0
    for title, table in (("Planning", PARAMETERS), ("The node's alone", NODE_PARAMETERS)):
        rows = [p for p in table.values() if args.pattern.lower() in f"{p.name} {p.description}".lower()]
        found += len(rows)
        if args.markdown:
            print(_markdown(title, rows))
            continue
        for p in rows:
            heading = f"{p.name} = {_value(p.default)} {p.unit}".rstrip() + f"   ({p.range_text})"
            out.print(Text(heading, style="bold"))
            out.print(Text("  " + p.description))
    if not found:
        print(f"no parameter's name or description holds {args.pattern!r}")
    return 0 if found else 1
