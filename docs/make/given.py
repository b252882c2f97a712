"""Makes and keeps, for the site, the picture on the page of each method and environment: what its sweep gives.

python docs/make/given.py               # those that are not there yet
python docs/make/given.py sarsa taxi    # these anew
"""

import os
import shlex
import sys
import tempfile
from pathlib import Path

import pages
from figures import shrink

import jaxrl_tab as rl
from jaxrl_tab.cli import main

DOCS = Path(__file__).resolve().parents[1]
WIDTH, COLOURS = 720, 32  # of which there are many


def keep(name: str) -> None:
    """Types the last command on the page of a method or environment, and keeps the picture that it gives."""
    kind, of = (
        ("environments", pages.environment_commands)
        if name in rl.ENVS
        else ("methods", pages.method_commands)
    )
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        if main([*shlex.split(of(name)[-1])[1:], "--quiet"]) == 0:
            (DOCS / kind).mkdir(exist_ok=True)
            shrink(Path(f"runs/{name}/overview.png"), DOCS / f"{kind}/{name}.png", WIDTH, COLOURS)
        os.chdir(DOCS)


if __name__ == "__main__":
    there = {path.stem for kind in ("methods", "environments") for path in (DOCS / kind).glob("*.png")}
    for name in sys.argv[1:] or [name for name in (*pages.METHODS, *rl.ENVS) if name not in there]:
        keep(name)
