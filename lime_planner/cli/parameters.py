"""`lime-planner parameters`: the one table of parameters, for reading or as documentation."""

from __future__ import annotations

import argparse
from typing import Any

from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS, Parameter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    from lime_planner.cli.json_output import add_json

    parser.epilog = "examples:\n  lime-planner parameters stem\n  lime-planner parameters --markdown\n  lime-planner parameters --json"
    parser.add_argument("pattern", nargs="?", default="", metavar="TEXT", help="only those whose name or description holds this text")
    parser.add_argument("--markdown", action="store_true", help="as a Markdown table")
    add_json(parser, "the same")


def _value(value: Any) -> str:
    return repr(value) if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else str(value)


def _markdown(title: str, rows: list[Parameter]) -> str:
    lines = [f"### {title}", "", "| name | default | unit | range | meaning |", "|---|---|---|---|---|"]
    lines += [f"| `{p.name}` | `{_value(p.default)}` | {p.unit} | {p.range_text} | {p.description} |" for p in rows]
    return "\n".join(lines) + "\n"


def _holds(parameter: Parameter, pattern: str) -> bool:
    return pattern.lower() in f"{parameter.name} {parameter.description}".lower()


def _figures(p: Parameter, of_node: bool) -> dict[str, Any]:
    limits = {"minimum": p.minimum, "maximum": p.maximum, "choices": list(p.choices)}
    known = {"default": p.default, "type": p.kind.__name__, "unit": p.unit, "description": p.description}
    return {**known, **limits, "read_only": p.read_only, "node_only": of_node}


def run(args: argparse.Namespace) -> int:
    """Print the parameters."""
    from rich.text import Text

    from lime_planner.cli.json_output import emit_json, is_stdout
    from lime_planner.output.console import console, wrapped

    out, found = console(), 0
    if args.json is not None:
        everything = [(p, p.name in NODE_PARAMETERS) for p in (*PARAMETERS.values(), *NODE_PARAMETERS.values())]
        emit_json(args.json, {p.name: _figures(p, of_node) for p, of_node in everything if _holds(p, args.pattern)})
    if is_stdout(args.json):
        return 0
    for title, table in (("Planning", PARAMETERS), ("The node's alone", NODE_PARAMETERS)):
        rows = [p for p in table.values() if _holds(p, args.pattern)]
        found += len(rows)
        if args.markdown:
            print(_markdown(title, rows))
            continue
        for p in rows:
            heading = f"{p.name} = {_value(p.default)} {p.unit}".rstrip() + f"   ({p.range_text})"
            out.print(Text("\n".join(wrapped(heading)), style="bold"), soft_wrap=True)
            print("\n".join(wrapped(p.description, first="  ")))
    if not found:
        print(f"no parameter's name or description holds {args.pattern!r}")
    return 0 if found else 1
