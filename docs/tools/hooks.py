"""What MkDocs calls while it builds: fills in the generated parts of the reference, and makes a page of the notebook."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import nbformat
import reference
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter
from nbconvert.preprocessors import Preprocessor

_HERE = Path(__file__).resolve().parent
NOTEBOOK = _HERE.parent / "notebooks" / "first_plan.ipynb"


class _HtmlFirst(Preprocessor):
    """Keeps one form of each output: a table in place of its text."""

    def preprocess_cell(self, cell: Any, resources: Any, index: int) -> tuple[Any, Any]:
        """Drop the text beside HTML and pictures."""
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if {"text/html", "image/png", "image/svg+xml"} & set(data):
                data.pop("text/plain", None)
        return cell, resources


def on_config(config: Any) -> Any:
    """Put pages that the navigation does not name, such as new results, at its end."""
    text = str(config["nav"])
    others = [page.name for page in sorted(_HERE.parent.glob("*.md")) if f"'{page.name}'" not in text]
    if others:
        config["nav"].append({"More": others})
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the notebook's page and its pictures."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    exporter = MarkdownExporter()
    exporter.register_preprocessor(_HtmlFirst, enabled=True)
    body, resources = exporter.from_notebook_node(notebook)
    page = f"notebooks/{NOTEBOOK.stem}.md"
    files.append(File.generated(config, page, content=body))
    for name, data in resources.get("outputs", {}).items():
        files.append(File.generated(config, f"notebooks/{name}", content=data))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Fill in the generated parts; a link to a folder, good where the sources are browsed, becomes its name."""
    here = Path(config["docs_dir"], page.file.src_uri).parent

    def name_of_folder(match: re.Match[str]) -> str:
        return f"`{match[1]}`" if (here / match[2]).is_dir() else match[0]

    return reference.fill(re.sub(r"(?<!!)\[([^\]]+)\]\(([\w./-]+)\)", name_of_folder, markdown))
