"""MkDocs hook: the notebooks, as they were executed, become pages with their pictures.

They are kept in `notebooks/` with their outputs, and tests run them anew; nothing is run here.
"""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add notebooks/<name>.md, and its pictures beside it."""
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        text, resources = MarkdownExporter().from_notebook_node(
            notebook, resources={"output_files_dir": path.stem, "unique_key": path.stem}
        )
        text = re.sub(r"<style scoped>.*?</style>", "", text, flags=re.DOTALL)  # pandas'
        text = re.sub(r"\]\((\d\d_\w+)\.ipynb\)", r"](\1.md)", text)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, content in resources["outputs"].items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files
