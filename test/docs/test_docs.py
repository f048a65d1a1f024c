"""The documentation builds without a warning and without the network, and says what the code says."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from shown import is_shown

ROOT = Path(__file__).resolve().parents[2]
pytest.importorskip("mkdocs", reason="mkdocs is not in this environment (extra `docs`)")


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT), **environment}
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, env=env, capture_output=True, text=True, timeout=180, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built pages; the proxy leads nowhere, so that a build that wants the network fails."""
    folder = tmp_path_factory.mktemp("site")
    nowhere = "http://127.0.0.1:9"
    done = run("-m", "mkdocs", "build", "--strict", "--site-dir", str(folder), http_proxy=nowhere, https_proxy=nowhere)
    assert done.returncode == 0, done.stderr
    return folder


class _Fetched(HTMLParser):
    """Collects what a browser loads for a page by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in ("script", "img", "source", "iframe", "video") and values.get("src"):
            self.addresses.append(str(values["src"]))
        if tag == "link" and values.get("href") and values.get("rel") not in ("canonical", "next", "prev"):
            self.addresses.append(str(values["href"]))


def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 12
    for page in pages:
        fetched = _Fetched()
        fetched.feed(page.read_text(encoding="utf-8"))
        assert fetched.addresses, page
        assert [a for a in fetched.addresses if "//" in a] == [], page
        if page.name != "404.html":  # its addresses are the server's
            missing = [a for a in fetched.addresses if not a.startswith("data:") and not (page.parent / re.sub(r"[?#].*", "", a)).exists()]
            assert missing == [], page


def test_search_works_in_pages_opened_as_files_and_finds_what_is_asked_for(site: Path) -> None:
    """A status first in the list of statuses, what to do with the installation on its page, a Python name in the Python reference."""
    expect = pytest.importorskip("playwright.sync_api").expect
    from browser import chromium

    with chromium() as browser:
        page = browser.new_page()
        page.goto((site / "tutorials" / "first-plan.html").as_uri())
        page.keyboard.press("s")
        page.get_by_text("Type to start searching").wait_for(timeout=60_000.0)
        field, first = page.locator("input.md-search__input"), page.locator(".md-search-result__item h1").first
        files = "Update, remove, and where files lie"
        wanted = {"GOAL_IN_STEM": "Statuses", "SUCCEEDED": "Statuses", "generate_plant": "Python"}
        wanted |= dict.fromkeys(("update", "updating", "upgrade", "remove", "uninstall"), files)
        for words, title in wanted.items():
            field.fill("")
            page.get_by_text("Type to start searching").wait_for(timeout=60_000.0)
            field.press_sequentially(words)
            first.wait_for(timeout=60_000.0)
            expect(first, words).to_have_text(title, timeout=60_000.0)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_can_be_read_on_screens_of_all_widths(site: Path, scheme: str) -> None:
    """One page of each kind: text with code, generated tables, a list of statuses, Python, a notebook."""
    pytest.importorskip("playwright.sync_api")
    from browser import chromium
    from legible import WIDTHS, faint, too_wide

    kinds = ("index", "tutorials/first-plan", "reference/parameters", "reference/statuses", "reference/python", "notebooks/first_plan")
    problems = []
    with chromium() as browser:
        page = browser.new_context(color_scheme=scheme).new_page()  # type: ignore[arg-type]
        for kind in kinds:
            page.goto((site / f"{kind}.html").as_uri(), wait_until="domcontentloaded", timeout=120_000.0)
            assert page.locator("body").get_attribute("data-md-color-scheme") == ("default" if scheme == "light" else "slate")
            problems += [f"{kind}: {words}" for words in faint(page)]
            for width in WIDTHS if scheme == "light" else ():  # colours take no room
                page.set_viewport_size({"width": width, "height": 800})
                problems += [f"{kind} at {width} px: {words}" for words in too_wide(page)]
    assert problems == []


def test_every_placeholder_is_filled(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert "{{" not in page.read_text(encoding="utf-8"), page


def test_the_reference_is_the_code(site: Path) -> None:
    from lime_planner import __all__ as public
    from lime_planner.cli.main import COMMANDS, _exists
    from lime_planner.core.parameters import NODE_PARAMETERS, PARAMETERS
    from lime_planner.core.status import Status

    def text(name: str) -> str:
        return (site / "reference" / f"{name}.html").read_text(encoding="utf-8")

    assert [name for name in (*PARAMETERS, *NODE_PARAMETERS) if f"<code>{name}</code>" not in text("parameters")] == []
    assert [status.name for status in Status if f"<code>{status.name}</code>" not in text("statuses")] == []
    assert [c.words for c in COMMANDS if _exists(c) and f"lime-planner {' '.join(c.words)}" not in text("command-line")] == []
    assert [name for name in public if name not in text("python")] == []


def test_the_interfaces_are_what_the_nodes_open() -> None:
    done = run("docs/tools/interfaces.py", "--check")
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_notebook_runs_and_is_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs; the committed outputs are those of these cells, their words and figures too, and not heavy."""
    import nbformat

    monkeypatch.syspath_prepend(str(ROOT / "docs" / "tools"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    run_notebook = importlib.import_module("run_notebook")
    kept = nbformat.read(run_notebook.NOTEBOOK, as_version=4)
    assert run_notebook.NOTEBOOK.stat().st_size < 150_000

    def kinds(notebook: Any) -> list[list[str]]:
        """The outputs of each cell by their kind, without Open3D's greeting."""
        cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
        return [sorted({output.output_type for output in cell.outputs if "Open3D" not in output.get("text", "")}) for cell in cells]

    def texts(notebook: Any) -> list[str]:
        outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
        found = [output.get("text") or output.get("data", {}).get("text/plain", "") for output in outputs]
        return [text.replace(f"{tmp_path}/", "") for text in found if "Open3D" not in text]

    expected, said = kinds(kept), texts(kept)
    assert all(expected), "outputs are missing; run: python docs/tools/run_notebook.py"
    now = run_notebook.run(kept, tmp_path)
    assert kinds(now) == expected
    wrong = [(text, printed) for text, printed in zip(said, texts(now), strict=True) if not is_shown(text, printed)]
    assert not wrong, "other outputs now; run: python docs/tools/run_notebook.py"
    assert "<b>SUCCEEDED</b>" in kept.cells[1].outputs[0].data["text/html"]


def test_shell_blocks_outside_the_tutorials_are_shell() -> None:
    """Those of the tutorials are run or checked by their own test."""
    from lime_planner.cli import main as cli

    checked = 0
    for page in (ROOT / "docs").glob("*.md"):
        for block in re.findall(r"^```bash[^\n]*\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL):
            done = subprocess.run(["bash", "-n"], input=block, capture_output=True, text=True, check=False)
            assert done.returncode == 0, f"{page.name}: {done.stderr}"
            for command in re.findall(r"^lime-planner (.+)$", block.replace("\\\n", " "), flags=re.MULTILINE):
                words = shlex.split(command, comments=True)
                assert cli.build_parser(words).parse_args(words), f"{page.name}: {command}"
            checked += 1
    assert checked
