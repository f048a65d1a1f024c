"""Runs docs/notebooks/first_plan.ipynb and keeps its outputs, pictures made small: python docs/tools/run_notebook.py."""

from __future__ import annotations

import base64
import io
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

NOTEBOOK = Path(__file__).resolve().parent.parent / "notebooks" / "first_plan.ipynb"
_WIDTH = 900  #: of a picture [pixels]


def run(notebook: Any, folder: Path) -> Any:
    """Run every cell in `folder` and return the notebook with its outputs.

    Raises:
        CellExecutionError: a cell fails.
    """
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


def small(data: str) -> str:
    """Return a PNG in base64 with fewer pixels and colours."""
    with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
        plain = Image.new("RGB", picture.size, "white")
        plain.paste(picture, mask=picture.getchannel("A") if picture.mode == "RGBA" else None)
    if plain.width > _WIDTH:
        plain = plain.resize((_WIDTH, round(plain.height * _WIDTH / plain.width)), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    plain.quantize(256, kmeans=3, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


def main() -> None:
    """Run and rewrite the notebook."""
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        run(notebook, Path(folder))
        for cell in notebook.cells:
            cell.metadata.pop("execution", None)
            if "outputs" in cell:
                cell.outputs = [o for o in cell.outputs if "Open3D" not in o.get("text", "")]  # its greeting to notebooks
            for output in cell.get("outputs", ()):
                data = output.get("data", {})
                if "image/png" in data:
                    data["image/png"] = small(data["image/png"])
                    output["metadata"] = {}
                for kind in ("text/plain", "text/html"):
                    if kind in data:
                        data[kind] = data[kind].replace(f"{folder}/", "")
    notebook.metadata["language_info"] = {"name": "python"}
    nbformat.write(notebook, NOTEBOOK)
    print(f"{NOTEBOOK.name}: {NOTEBOOK.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
