"""The notebooks of the examples, which are kept with their outputs: `python tests/notebooks.py` makes them anew."""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent.parent / "examples"
NAMES = sorted(file.stem for file in FOLDER.glob("*.ipynb"))


def kept(name: str) -> nbformat.NotebookNode:
    """The notebook as it was saved."""
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


def executed(name: str) -> nbformat.NotebookNode:
    """The notebook, run from the beginning, with nothing in it that is another thing each time."""
    notebook = kept(name)
    folder = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(notebook, timeout=300, resources=folder, record_timing=False).execute()
    notebook.metadata.language_info = {"name": "python"}
    for cell in notebook.cells:  # where a bar was
        if "outputs" in cell:
            cell.outputs = [x for x in cell.outputs if x.get("data", {}).get("text/html") != ""]
    return notebook


if __name__ == "__main__":
    for each in NAMES:
        nbformat.write(executed(each), FOLDER / f"{each}.ipynb")
