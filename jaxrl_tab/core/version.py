"""The version of the package: that of the last tag in git when it was built or installed (see pyproject.toml).

Whoever imports this looks among the installed packages, which takes some 30 ms where nothing else has: so what starts
quickly imports it only when it is asked for.
"""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("jaxrl-tab")
except PackageNotFoundError:  # the sources alone, which nobody installed
    __version__ = "0+unknown"
