"""Hands the pages that are made to MkDocs, and puts them, and whatever else lies in docs/, into the navigation."""

from pathlib import Path
from typing import Any

import docstrings
import pages
from mkdocs.structure.files import File, InclusionLevel

DOCS = Path(__file__).parents[1]
MADE: dict[str, str] = {}


def on_config(config: Any) -> None:
    MADE.update(pages.pages())
    fence = {"name": "formula", "class": "formula", "format": docstrings.formula}
    config.mdx_configs["pymdownx.superfences"]["custom_fences"].append(fence)
    here = {path.relative_to(DOCS).as_posix() for path in DOCS.glob("*.md")}
    config.nav = expanded(
        config.nav, here - named(config.nav), [x for x in MADE if x not in named(config.nav)]
    )


def named(nav: Any) -> set[str]:
    """The pages that a navigation names."""
    if isinstance(nav, str):
        return {nav}
    return set().union(*map(named, nav.values() if isinstance(nav, dict) else nav))


def expanded(nav: Any, written: set[str], made: list[str]) -> Any:
    """The navigation with "*" as the other pages in docs/, and "methods/" as those that are made there."""
    if isinstance(nav, dict):
        return {title: expanded(below, written, made) for title, below in nav.items()}
    if isinstance(nav, list):
        below = [expanded(one, written, made) for one in nav]
        return [page for one in below for page in (one if isinstance(one, list) else [one])]
    if nav == "*":
        return sorted(written)
    return [page for page in made if page.startswith(nav)] if nav.endswith("/") else nav


def on_files(files: Any, config: Any) -> Any:
    for path, text in MADE.items():
        shown = InclusionLevel.NOT_IN_NAV if path.startswith("files/") else InclusionLevel.INCLUDED
        files.append(File.generated(config, path, content=text, inclusion=shown))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    return markdown if page.file.generated_by else pages.in_the_site(markdown)


def on_post_page(output: str, **_: Any) -> str:
    """Before the theme's own script, what it needs where the site is read as files."""
    script = (DOCS / "make/offline.js").read_text(encoding="utf-8")
    return output.replace("</head>", f"<script>{script}</script></head>")


def on_post_build(config: Any) -> None:
    """The index of the search also as a script, since a page that is a file may read no other file."""
    folder = Path(config.site_dir) / "search"
    index = (folder / "search_index.json").read_text(encoding="utf-8")
    (folder / "search_index.js").write_text(f"var __index = {index}", encoding="utf-8")
