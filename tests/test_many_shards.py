"""Very many shards: what they take beside computing grows as they do, and no result is held once it is written."""

import sys
import weakref
from itertools import pairwise

import jaxrl_tab as rl
from benchmarks import shards as of_nothing
from jaxrl_tab.experiment import disk, runner


class Watched(of_nothing.Nothing):
    """Gives each result in arrays of its own, and sees that nobody holds those of the one before."""

    def run(self, work, tasks):
        last = lambda: None
        for task, arrays in super().run(work, tasks):
            own = {name: x.copy() for name, x in arrays.items()}
            before, last = last, weakref.ref(own["q"])
            yield task, own
            del own
            assert before() is None


def taken(count, folder, monkeypatch):
    """Calls of functions, and bytes written, of a run of so many shards and of a `resume` of them."""
    calls, written, write, results = 0, 0, disk.write, runner._results

    def count_call(frame, event, arg):
        nonlocal calls
        calls += event in ("call", "c_call")

    def count_bytes(path, data):
        nonlocal written
        written += len(data)
        write(path, data)

    def counted(*given):
        sys.setprofile(count_call)
        try:
            return results(*given)
        finally:
            sys.setprofile(None)

    with of_nothing.of_nothing(), monkeypatch.context() as patched:
        patched.setattr(disk, "write", count_bytes)
        patched.setattr(runner, "_results", counted)
        patched.setattr(runner, "write_files", lambda *_: None)
        rl.run(of_nothing.experiment(count), folder, executor=Watched(), progress=False, formats=())
        rl.resume(folder, progress=False, formats=())
    return calls, written


def test_twice_as_many_shards_take_twice_as_much(tmp_path, monkeypatch):
    """It is 1.98 times as much; what grew with their square would in the end be four times as much.

    Broken once, each: the manifest written after each shard -> 3.9 times the bytes; a single call for all shards, for
    each of them -> 2.08 times the calls; the last result held -> fails.
    """
    counts = (10, 50, 100, 200)
    found = [taken(count, tmp_path / str(count), monkeypatch) for count in counts]
    found = found[1:]  # the first also did what is done once in a process
    more = [[b - a for a, b in zip(*pair, strict=True)] for pair in pairwise(found)]
    for what, (first, second) in zip(("calls", "bytes"), zip(*more, strict=True), strict=True):
        assert second < 2.04 * first, (what, found)
