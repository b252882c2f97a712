"""The notebook of the examples, which is kept with its outputs: `python tests/quick_start.py` makes them anew."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

FILE = Path(__file__).parent.parent / "examples" / "quick_start.ipynb"


def executed() -> nbformat.NotebookNode:
    """The notebook, run from the beginning, with nothing in it that is another thing each time."""
    notebook = nbformat.read(FILE, as_version=4)
    folder = {"metadata": {"path": str(FILE.parent)}}
    NotebookClient(notebook, timeout=300, resources=folder, record_timing=False).execute()
    notebook.metadata.language_info = {"name": "python"}
    return notebook


if __name__ == "__main__":
    nbformat.write(executed(), FILE)
