"""Keeps, for the site, what `jaxrl-tab figure` gave: small pictures, and what the numbers came to.

python docs/make/figures.py runs/figures            # of `jaxrl-tab figure --all --out runs/figures`
python docs/make/figures.py runs/regret regret      # of `jaxrl-tab figure regret --out runs/regret`
"""

import json
import sys
from pathlib import Path

import xarray as xr
from PIL import Image

from jaxrl_tab.figures import FIGURES
from jaxrl_tab.figures.page import cells

KEPT = Path(__file__).parents[1] / "figures"
NUMBERS = KEPT / "numbers.json"
WIDTH, COLOURS = 840, 64  # of a picture in the gallery


def keep(folder: Path, alone: str = "") -> None:
    """Keeps the figures that are in a folder; those that are not, as they were kept before."""
    kept = json.loads(NUMBERS.read_text(encoding="utf-8"))
    with xr.open_datatree(folder / "results.nc", engine="h5netcdf") as tree:
        made = {alone: tree} if alone else {name: tree[name] for name in FIGURES if name in tree.children}
        for name, of_figure in made.items():
            runs = [node for node in of_figure.subtree if node.data_vars]
            above = f"{of_figure.path.rstrip('/')}/"
            datasets = {node.path.removeprefix(above): node.to_dataset() for node in runs}
            kept[name] = [_row(*cells(number.check(datasets))) for number in FIGURES[name].numbers]
            shrink(folder / f"{name}.png", KEPT / f"{name}.png")
    text = json.dumps({name: kept[name] for name in FIGURES if name in kept}, ensure_ascii=False, indent=1)
    NUMBERS.write_text(text + "\n", encoding="utf-8")


def _row(what: str, published: str, got: str, error: str, expected: str, *_: str) -> dict[str, str]:
    return {"what": what, "published": published, "got": got, "error": error, "expected": expected}


def shrink(file: Path, kept: Path, width: int = WIDTH, colours: int = COLOURS) -> None:
    """The picture as wide as a page, and of few colours."""
    with Image.open(file) as picture:
        small = picture.convert("RGB")
        small.thumbnail((width, 10 * width), Image.Resampling.LANCZOS)
        small.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            kept, optimize=True
        )


if __name__ == "__main__":
    keep(Path(sys.argv[1]), *sys.argv[2:3])
