"""Compiled programs that outlive the process: a second start of the command neither traces nor compiles.

JAX's own persistent cache spares the compiler, but not the tracing before it, which takes as long. Here a
program is found by what it is made from: the sources of this package, the versions and settings of JAX, the
machine, and the method, environment and budget. Only what consists of this package's own classes is kept:
the code behind anybody else's may change without a trace in the name.

Off until `keep` is called, which the command line does. A file that cannot be read or written is not
missed: the program is made again.
"""

import contextlib
import hashlib
import io
import os
import pickle
import platform
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import jax

T = TypeVar("T")

PACKAGE = Path(__file__).parent
AT_MOST = 512  # files; when there are more, those that were not used for longest go
_folder: Path | None = None


def keep(folder: Path | None = None) -> None:
    """From now on keeps compiled programs in `folder`, for this process and later ones.

    By default that is where the user's `JAX_COMPILATION_CACHE_DIR` says, or else the user's cache folder
    (`XDG_CACHE_HOME`), and JAX is told to keep there what else it compiles. `JAX_ENABLE_COMPILATION_CACHE=0`
    turns both off.
    """
    global _folder
    if not jax.config.jax_enable_compilation_cache:  # pyright: ignore[reportAttributeAccessIssue]
        return
    chosen = folder or jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        chosen = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxrl_tab"
        jax.config.update("jax_compilation_cache_dir", str(chosen))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    _folder = Path(chosen) / "programs"


def kept(name: Any, make: Callable[[str], T], pack: Callable[[T], Any], unpack: Callable[[Any], T]) -> T:
    """What `make` gives, or gave in an earlier process under the same `name`.

    Args:
        name: a pytree of all that it depends on, besides code, versions and settings.
        make: makes it, under the name in JAX that it is given: one that is kept here has no other's.
        pack, unpack: to something that can be pickled, and back.
    """
    file = _file(name)
    if file is None:
        return make("program")
    # Whatever is wrong with the file, a newer one is as good: jaxlib's errors have no common type.
    with contextlib.suppress(Exception):
        found = unpack(pickle.loads(file.read_bytes()))
        os.utime(file)
        return found
    with _unknown_to_jax():
        made = make("kept_program")
    with contextlib.suppress(Exception):
        _write(file, pickle.dumps(pack(made)))
    return made


@contextlib.contextmanager
def _unknown_to_jax() -> Iterator[None]:
    """Keeps what is compiled within out of JAX's cache: what comes from there cannot be written down again.

    (On a CPU with jax 0.10.2 it can, but what is read then says "Function ... not found" when it is called.)
    """
    setting = "jax_persistent_cache_min_compile_time_secs"
    before = jax.config.values[setting]
    jax.config.update(setting, 1e9)
    try:
        yield
    finally:
        jax.config.update(setting, before)


def _file(name: Any) -> Path | None:
    """Where it is kept; None where it is not."""
    if _folder is None:
        return None
    pickled = io.BytesIO()
    try:
        _Named(pickled, protocol=5).dump(name)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    settings = repr(sorted(jax.config.values.items()))
    parts = (
        pickled.getvalue(),
        settings.encode(),
        os.environ.get("XLA_FLAGS", "").encode(),
        _code_and_machine(),
    )
    return _folder / hashlib.sha256(b"\0".join(parts)).hexdigest()


class _Named(pickle.Pickler):
    """Refuses classes and functions whose code is not in this package, in JAX or in NumPy."""

    def reducer_override(self, obj: Any) -> Any:
        module = getattr(obj if isinstance(obj, type) else type(obj), "__module__", "")
        if module.partition(".")[0] not in ("jaxrl_tab", "jax", "jaxlib", "numpy", "ml_dtypes", "builtins"):
            raise pickle.PicklingError(f"{obj} is not of jaxrl_tab")
        return NotImplemented


@cache
def _code_and_machine() -> bytes:
    """All that a program depends on and nobody passes: a digest."""
    digest = hashlib.sha256()
    for file in sorted(PACKAGE.rglob("*.py")):
        digest.update(file.read_bytes())
    cpu = ""
    with contextlib.suppress(OSError):  # Linux alone has it
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    devices = [(d.platform, d.device_kind) for d in jax.devices()]
    about = jax.__version__, version("jaxlib"), platform.platform(), platform.machine(), cpu, devices
    digest.update(repr(about).encode())
    return digest.digest()


def _write(file: Path, data: bytes) -> None:
    """Puts `data` under its name at once and whole; then makes room."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, prefix=".", delete=False) as temporary:
        temporary.write(data)
    os.replace(temporary.name, file)
    files = sorted(file.parent.iterdir(), key=lambda f: f.stat().st_mtime)
    for old in files[:-AT_MOST]:
        old.unlink(missing_ok=True)
