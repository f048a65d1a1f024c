"""Every command that is printed anywhere is one: in help, README, docs, docstrings and messages.

All are parsed by the command line's own parser, and their parameters looked up. What the helps print is also run, in the order of the
page, where neither a graph of nodes, a browser nor hours are needed. The blocks of the tutorials are run by `test/docs/test_tutorials.py`.
"""

from __future__ import annotations

import ast
import contextlib
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import shared_data

from lime_planner.cli import main as cli
from lime_planner.core.parameters import parse_assignment
from lime_planner.scene.ply_pcd import write_cloud

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = sorted((ROOT / "lime_planner").rglob("*.py"))
FIRST_WORDS = {command.words[0] for command in cli.COMMANDS}


@dataclass(frozen=True)
class Printed:
    """A command as it stands somewhere."""

    where: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.where}: lime-planner {shlex.join(self.words)}"


def commands_in(text: str, where: str) -> Iterator[Printed]:
    """Yield the commands `lime-planner …` of a text: to the end of the line, of the code span, or of the command in the shell's sense."""
    joined = re.sub(r" *\\\n\s*", " ", text)
    for match in re.finditer(r"(?:^|[`'(\s;&|])(?:\.venv/bin/)?lime-planner[ \t]+(?=([^\n`]+))", joined):
        line = re.split(r"\s&&\s|\s\|\s|\s#|\s>|;|\)\s*$|\s{3,}|(?<=[a-z]): |, |\. |\.$|…| → | \(", match[1])[0].rstrip("'\").,:")
        with contextlib.suppress(ValueError):  # an odd quote: prose
            words = tuple(shlex.split(line))
            if words and words[0] in FIRST_WORDS and "..." not in line and not any("|" in word for word in words):
                yield Printed(where, words)


def printed_commands() -> list[Printed]:
    found = [command for page in PAGES for command in commands_in(page.read_text(encoding="utf-8"), str(page.relative_to(ROOT)))]
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "lime-planner " in text else ():
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and "lime-planner " in node.value:
                found += commands_in(node.value, f"{path.relative_to(ROOT)}:{node.lineno}")
    return list(dict.fromkeys(found))


def is_named_without_arguments(printed: Printed, parser_error: str) -> bool:
    """Whether a command is only spoken of: `lime-planner plan` in a sentence needs no scene."""
    return not any(word.startswith("-") for word in printed.words) and ("required" in parser_error or "give " in parser_error)


@pytest.mark.parametrize("printed", printed_commands(), ids=str)
def test_every_printed_command_is_one(printed: Printed, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    words = list(printed.words)
    try:
        args = cli.build_parser(words).parse_args(words)
    except SystemExit as end:
        error = capsys.readouterr().err
        added = re.search(r"'(\w+)' is not one of them", error)  # a page may show how to add what it names
        if added and f'"{added[1]}"' in (ROOT / printed.where.partition(":")[0]).read_text(encoding="utf-8"):
            return
        assert end.code == 0 or is_named_without_arguments(printed, error), f"{printed}\n{error}"
        return
    for text in getattr(args, "assignments", None) or []:
        if "=" in text and text != "PARAMETER=VALUE":
            parse_assignment(text)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the examples take for granted: a scan of a plant that stands at the origin, and a recorded scene."""
    folder = tmp_path_factory.mktemp("workshop")
    file = shared_data() / "tomato_wur_h01p179_pred.npz"
    with np.load(file) as scan:
        write_cloud(folder / "scan.ply", scan["points"].astype(np.float32), scan["labels"].astype(np.uint8), None)
    (folder / "scans").mkdir()
    shutil.copy(file, folder / "scans" / "tomato_wur_h01p179.npz")
    assert cli.main(["scene", "plant", "--seed", "2", "--out", str(folder / "now.npz")]) == 0
    return folder


def can_be_run(printed: Printed) -> bool:
    """Whether an example of a help ends by itself, within seconds, on files alone."""
    words = printed.words
    own = printed.where.startswith("lime_planner/cli/") and len(words) > 1
    files_alone = not {"--live", "--bag", "planning_frame=j2s6s200_link_base"} & set(words) and words[:2] != ("scene", "tomatowur")
    return own and files_alone and words[0] in ("scene", "plan", "doctor", "parameters", "completion") and words[:2] != ("plan", "--json")


def test_the_examples_of_the_helps_do_what_they_say(
    workshop: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(workshop)
    wanted = [printed for printed in printed_commands() if can_be_run(printed)]
    plants_first = sorted(wanted, key=lambda printed: printed.words[:2] != ("scene", "plant"))
    for printed in sorted(plants_first, key=lambda printed: "dense" in printed.words):  # the sparser plant is what the other pages plan on
        words = list(printed.words)
        try:
            code = cli.main(words)
        except SystemExit as end:  # --help
            code = end.code
        said = capsys.readouterr()
        assert code == 0, f"{printed}\n{said.err}"
        for option in ("--out", "--json", "--picture"):
            if option in words[:-1] and not words[words.index(option) + 1].startswith("-"):
                assert (workshop / words[words.index(option) + 1]).stat().st_size > 0, printed
    assert len(wanted) >= 20


def test_the_collection_finds_what_is_printed() -> None:
    found = {printed.words[0] for printed in printed_commands()}
    assert found >= FIRST_WORDS - {"demo", "completion", "compile"}
    text = "see `lime-planner plan a.npz`; or\n  lime-planner plan b.ply \\\n      --offset 1 2 3 && lime-planner view plan.json   # looks"
    assert [command.words for command in commands_in(text, "")] == [
        ("plan", "a.npz"),
        ("plan", "b.ply", "--offset", "1", "2", "3"),
        ("view", "plan.json"),
    ]
