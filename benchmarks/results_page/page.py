"""The results page: between its markers stand texts that are made from the kept results, and from nothing else.

A marker is a line `<!-- name -->`, its text ends at the line `<!-- end -->`; `results_blocks.BLOCKS` says what belongs there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from benchmarks.results_page.blocks import BLOCKS
from benchmarks.results_page.kept_results import Results, read
from lime_planner.core.errors import SceneError

_BLOCK = re.compile(r"^<!-- (?P<name>[a-z]+[a-z0-9.-]*) -->\n(?P<text>.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL)


def blocks_in(page: str) -> dict[str, str]:
    """Name and present text of every block of a page."""
    return {m["name"]: m["text"] for m in _BLOCK.finditer(page)}


def filled(page: str, folder: Path) -> str:
    """Return the page with every block made again from the kept results in a folder.

    Raises:
        SceneError: an unknown block, or results that are not there.
    """
    known: dict[str, Results] = {}

    def text_of(found: re.Match[str]) -> str:
        name = found["name"]
        if name not in BLOCKS:
            raise SceneError(f"block {name!r} of the page is none of {', '.join(BLOCKS)}")
        sources, make = BLOCKS[name]
        for source in sources:
            if source not in known:
                known[source] = read(folder / f"{source}.json")
        return f"<!-- {name} -->\n{make(*(known[source] for source in sources)).strip()}\n<!-- end -->"

    return _BLOCK.sub(text_of, page)


def without_blocks(page: str) -> str:
    """A page without the texts that are made from results."""
    return _BLOCK.sub("", page)


def numbers_outside(page: str) -> list[str]:
    """Numbers of a page that stand in no block, code or link, so that where they come from can be checked."""
    rest = without_blocks(page)
    rest = re.sub(r"```.*?```|`[^`]*`|\]\([^)]*\)", "", rest, flags=re.DOTALL)
    return re.findall(r"(?<![\w.])\d+(?:,\d{3})*(?:\.\d+)?", rest)


def missing(page: str, folder: Path) -> Mapping[str, str]:
    """Blocks whose text in the page is not what the kept results give, with the text that it should be."""
    wanted = blocks_in(filled(page, folder))
    return {name: wanted[name] for name, text in blocks_in(page).items() if text != wanted[name]}
