"""The parser of the command line: help that fits the terminal, and refusals that say what was probably meant."""

from __future__ import annotations

import argparse
import difflib
import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NoReturn

_WIDEST = 80
_NARROWEST = 40


def sentence(text: str) -> str:
    """Return a line of help as a sentence; what is in capitals stays so."""
    return f"{text[:1].upper()}{text[1:]}."


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Help within the terminal's columns (COLUMNS, if set), at most 80."""

    def __init__(self, prog: str) -> None:
        columns = min(_WIDEST, max(_NARROWEST, shutil.get_terminal_size((_WIDEST, 24)).columns))
        super().__init__(prog, max_help_position=26 if columns >= 70 else 16, width=columns)
        self._action_max_length = 14  # argparse forgets that the names of commands are indented

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        lines = text.splitlines()
        if max(map(len, lines), default=0) <= self._width:
            return super()._fill_text(text, width, indent)
        return "\n".join(_narrowed(lines, self._width))


def _narrowed(lines: Sequence[str], width: int) -> Iterator[str]:
    """Yield text within fewer columns: paragraphs wrapped, commands (which are indented) continued on further lines."""
    prose: list[str] = []
    command = ""
    for line in [*lines, ""]:
        if line.startswith("  "):
            command += line.strip().removesuffix("\\") if command else line.removesuffix("\\")
        elif line:
            prose.append(line)
        if prose and (command or not line):
            yield from textwrap.wrap(" ".join(prose), width, break_long_words=False, break_on_hyphens=False)
            prose = []
        if command and not line.endswith("\\"):
            yield from _wrapped_command(command, width)
            command = ""
        if not line:
            yield line


def _wrapped_command(line: str, width: int) -> list[str]:
    command, _, comment = line.partition("   ") if re.search(r"\S {3,}", line) else (line, "", "")
    command, comment = (line[: len(line) - len(line.lstrip())] + command.strip(), comment.strip()) if comment else (line, "")
    parts = textwrap.wrap(command, width - 2, subsequent_indent="      ", break_long_words=False, break_on_hyphens=False)
    found = [f"{part} \\" for part in parts[:-1]] + parts[-1:]
    return found + textwrap.wrap(comment, width, initial_indent="      # ", subsequent_indent="      # ")


def closest(word: str, known: Iterable[str], count: int = 1) -> list[str]:
    """Return the words that a mistyped one was probably meant to be."""
    names = list(known)
    lower = {name.lower(): name for name in names}
    return [lower[match] for match in difflib.get_close_matches(word.lower(), lower, n=count, cutoff=0.6)]


class Parser(argparse.ArgumentParser):
    """A parser that takes -1e-05 for a number, not for an option, and says what was probably meant."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(formatter_class=_Formatter, **kwargs)
        self._negative_number_matcher = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and refuse what is left over with the option that is closest to it."""
        found, rest = self.parse_known_args(args, namespace)
        if rest:
            self._refuse(rest, args or ())
        return found

    def _refuse(self, rest: Sequence[str], arguments: Sequence[str]) -> NoReturn:
        parser = self._leaf(arguments)
        words = []
        for word in rest:
            if not word.startswith("-"):
                continue
            option = word.partition("=")[0]
            own = [name for action in parser._actions for name in action.option_strings]
            options = list(own)
            if "--set" in options:
                options += [name for name in _as_options() if name not in options]
            match = closest(option.replace("_", "-"), options)
            meant = f"--set {match[0][2:].replace('-', '_')}=…" if match and match[0] not in own else "".join(match)
            words.append(f"there is no option {option}" + (f"; did you mean {meant}?" if meant else ""))
        parser.error("; ".join(words) or f"unrecognized arguments: {' '.join(rest)}")

    def _leaf(self, arguments: Sequence[str]) -> argparse.ArgumentParser:
        """Return the parser of the command that the arguments name."""
        parser: argparse.ArgumentParser = self
        for word in arguments:
            below = next((a for a in parser._actions if isinstance(a, argparse._SubParsersAction)), None)
            if below is not None and word in below.choices:
                parser = below.choices[word]
        return parser

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        try:
            return super()._get_value(action, arg_string)
        except argparse.ArgumentError:
            if action.type not in (int, float):
                raise
            noun = "whole number" if action.type is int else "number"
            raise argparse.ArgumentError(action, f"{arg_string!r} is no {noun}") from None

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        choices = [str(choice) for choice in action.choices]
        commands = isinstance(action, argparse._SubParsersAction)
        match = [f"{name} {value}" for name, below in _groups(action) if value in below] if commands else []
        match = match or closest(str(value), choices)
        hint = f"did you mean {match[0]}? " if match else ""
        what = f"there is no command {value!r}" if commands else f"{value!r} is not one of them"
        raise argparse.ArgumentError(None if commands else action, f"{what}; {hint}(choose from {', '.join(choices)})")


def _groups(action: Any) -> Iterator[tuple[str, list[str]]]:
    """Yield the commands that have commands of their own, and these."""
    for name, parser in action.choices.items():
        for below in parser._actions:
            if isinstance(below, argparse._SubParsersAction):
                yield name, list(below.choices)


def _as_options() -> list[str]:
    """Return the parameters spelt as if they were options."""
    from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS

    return [f"--{name.replace('_', '-')}" for name in (*PARAMETERS, *NODE_PARAMETERS)]
