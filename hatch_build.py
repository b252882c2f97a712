"""What a package index shows of this package: README.md, whose links lead to the repository once it has an address.

It is the `Source` of `[project.urls]` in pyproject.toml, and stands nowhere else. Without one links stay as they are.
"""

import re
from pathlib import Path
from typing import Any


def readme(text: str, source: str | None) -> str:
    """README.md with links that are right wherever it is read: pictures as files, all else as pages of the `source`."""
    if source is None:
        return text
    at = lambda kind: rf"\1{source.rstrip('/')}/{kind}/HEAD/\2"
    text = re.sub(r"(!\[[^]]*\]\()(?!\w+:)([^)]+)", at("raw"), text)
    return re.sub(r"((?<!!)\[[^]]*\]\()(?!\w+:|#)([^)]+)", at("blob"), text)


try:
    from hatchling.metadata.plugin.interface import MetadataHookInterface
except ImportError:  # the tests look at links, and need no tool that builds
    pass
else:

    class Readme(MetadataHookInterface):
        """Gives a package its README."""

        def update(self, metadata: dict[str, Any]) -> None:
            text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
            source = metadata.get("urls", {}).get("Source")
            metadata["readme"] = {"content-type": "text/markdown", "text": readme(text, source)}
