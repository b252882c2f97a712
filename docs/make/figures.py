"""Keeps, for the site, what `jaxrl-tab figure --all --out FOLDER` gave: small pictures, and what the numbers came to.

python docs/make/figures.py runs/figures
"""

import json
import sys
from pathlib import Path

import xarray as xr
from PIL import Image

from jaxrl_tab.figures import FIGURES
from jaxrl_tab.figures.page import cells

KEPT = Path(__file__).parents[1] / "figures"
WIDTH, COLOURS = 840, 64


def keep(folder: Path) -> None:
    """Makes the pictures and numbers.json of docs/figures anew."""
    KEPT.mkdir(exist_ok=True)
    numbers = {}
    with xr.open_datatree(folder / "results.nc", engine="h5netcdf") as tree:
        for name, figure in FIGURES.items():
            if name not in tree.children:  # it came later
                continue
            runs = [node for node in tree[name].subtree if node.data_vars]
            datasets = {node.path.removeprefix(f"/{name}/"): node.to_dataset() for node in runs}
            numbers[name] = []
            for number in figure.numbers:
                what, published, got, error, expected, *_ = cells(number.check(datasets))
                row = {"what": what, "published": published, "got": got, "error": error, "expected": expected}
                numbers[name].append(row)
            _shrink(folder / f"{name}.png", KEPT / f"{name}.png")
    text = json.dumps(numbers, ensure_ascii=False, indent=1)
    (KEPT / "numbers.json").write_text(text + "\n", encoding="utf-8")


def _shrink(file: Path, kept: Path) -> None:
    """The picture as wide as a page, and of few colours."""
    with Image.open(file) as picture:
        small = picture.convert("RGB")
        small.thumbnail((WIDTH, 10 * WIDTH), Image.Resampling.LANCZOS)
        small.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
            kept, optimize=True
        )


if __name__ == "__main__":
    keep(Path(sys.argv[1]))
