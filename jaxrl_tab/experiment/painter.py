"""A process beside this one that draws the pictures, while this one computes and writes everything else.

Matplotlib takes half a second to be imported, and longer to draw, and nothing else can run in Python meanwhile. So
the command line starts the other process before it imports anything itself: where there are pictures to draw, that
one is ready. It draws while this one works out and shows the table. Whatever goes wrong there, the pictures are drawn
here.
"""

import contextlib
import gc
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxrl_tab.core.cores import cores

if TYPE_CHECKING:
    from jaxrl_tab.show.searched import Ways
    from jaxrl_tab.stats.columns import Methods

PATIENCE = 60.0  # seconds; who has computed for so long does not mind drawing for one
LARGEST = 2**26  # bytes of results that are sent to the other process
START = "import sys; sys.path[:] = sys.argv[1:]; from jaxrl_tab.experiment.painter import main; main()"


class Drawing(NamedTuple):
    """The pictures of an environment: what `plot.save_all` takes; and of the search, where one found the settings."""

    methods: "Methods"
    env: Any
    folder: Path
    formats: Sequence[Any]
    searches: "Sequence[Ways]" = ()

    def draw(self) -> None:
        from jaxrl_tab.show import plot, search_curves  # and with it Matplotlib

        plot.save_all(self.methods, self.env, self.folder, self.formats)
        if self.searches:
            ds = next(iter(self.methods.values()))
            picture = search_curves.search(self.searches, "steps" if "num_steps" in ds.attrs else "episodes")
            for one in self.formats:
                plot.save(picture, self.folder / f"search.{one}")


_beside: ContextVar["subprocess.Popen[bytes] | None"] = ContextVar("painter", default=None)


@contextlib.contextmanager
def beside() -> Iterator[None]:
    """Within the block there is a process that draws the pictures of one experiment, where there is a core for it."""
    if cores() < 2:
        yield
        return
    # In a session of its own, since it is this process that Ctrl-C is for; it ends when its input does.
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", START, *sys.path],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
        start_new_session=True,
    )
    token = _beside.set(process)
    try:
        yield
    finally:
        _beside.reset(token)
        process.kill()  # what it was to draw is drawn, or nobody waits for it
        process.wait()
        _close(process)


@contextlib.contextmanager
def drawing(what: Sequence[Drawing]) -> Iterator[Callable[[], None]]:
    """Within the block all is drawn beside it, where that is possible.

    It gives a function that returns when all is drawn; what was not drawn beside is drawn by it.
    """
    process, sent = _beside.get(), False
    if process and process.poll() is None and what and (data := _packed(what)):
        sent = True
        threading.Thread(target=_send, args=(process, data), daemon=True).start()

    def finish() -> None:
        if not (process and sent and _has_drawn(process)):
            for one in what:
                one.draw()

    try:
        yield finish
    except BaseException:
        if process:
            process.kill()  # before the folder goes that it draws into
            process.wait()
        raise


def _has_drawn(process: "subprocess.Popen[bytes]") -> bool:
    """Waits until the process has ended. Whether it has drawn all."""
    return process.wait() == 0


def _packed(what: Sequence[Drawing]) -> bytes | None:
    """What is sent; None where it is too large, or where there are classes in it that only this process knows."""
    if sum(ds.nbytes for one in what for ds in one.methods.values()) > LARGEST:
        return None
    try:
        return pickle.dumps(what)
    except Exception:  # there is no end to what classes of somebody's own may raise
        return None


def _send(process: "subprocess.Popen[bytes]", data: bytes) -> None:
    assert process.stdin
    with contextlib.suppress(OSError):  # the process may have ended
        process.stdin.write(len(data).to_bytes(8))
        process.stdin.write(data)
        process.stdin.flush()  # and it is left open: the end of it is the end of this process


def _close(process: "subprocess.Popen[bytes]") -> None:
    assert process.stdin
    with contextlib.suppress(OSError):  # as where something cannot be written any more
        process.stdin.close()


def main() -> None:
    """What the other process does: gets ready, waits for its one task, does it, and says by its code that it did.

    Where the process that started it ends, it does, too.
    """
    end = threading.Timer(PATIENCE, os._exit, (1,))
    end.daemon = True
    end.start()
    gc.disable()  # looking for garbage takes a tenth of so short a life
    from jaxrl_tab.engine import programs
    from jaxrl_tab.show import plot  # noqa: F401  while nothing is there yet to be drawn

    programs.keep()
    data = sys.stdin.buffer.read(int.from_bytes(sys.stdin.buffer.read(8)))
    end.cancel()
    threading.Thread(target=_end_with_input, daemon=True).start()
    for one in pickle.loads(data):  # nobody but the process that started this one can write there
        one.draw()
    os._exit(0)  # all is in files; to take everything to pieces first would take a fifth of the time


def _end_with_input() -> None:
    os.read(sys.stdin.fileno(), 1)  # nothing more ever comes
    os._exit(1)
