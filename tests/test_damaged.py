"""Folders that are damaged, by disks or by people: right in the end, or refused in one line; nothing else.

    python test_damaged.py SEED TRIALS

tries more than the tests do.
"""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import tiny
from marks import slow_but_first

import jaxrl_tab as rl
from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.experiment import disk, runner, storage

TRIALS = 40
VALUES = (None, True, [], {}, [1, 2], "x", -1, 10**400, 1e308, {"a": 1}, [[]] * 9, "../../outside.txt")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A finished folder, one in which a shard and all files are still to be made, and the numbers."""
    path = tmp_path_factory.mktemp("damaged")
    with tiny.small():
        return make_folders(path)


def make_folders(path):
    rl.run(tiny.EXPERIMENT, path / "finished")
    shutil.copytree(path / "finished", path / "half")
    for name in ("results.nc", "summary.csv", "overview.png", "report.html"):
        (path / "half" / name).unlink()
    (path / "half" / "shards" / "000001.npz").unlink()
    manifest = storage.read_manifest(path / "half")
    assert manifest
    del manifest["shards"]["000001.npz"]
    storage._write_manifest(path / "half", manifest | {"files": {}})
    return [path / "finished", path / "half"], tiny.numbers(path / "finished")


def flip(rng, file):
    data = bytearray(file.read_bytes())
    for place in rng.integers(len(data), size=rng.integers(1, 4)):
        data[place] ^= 1 << rng.integers(8)
    file.write_bytes(data)


def truncate(rng, file):
    os.truncate(file, rng.integers(file.stat().st_size))


def zeros(rng, file):
    data = bytearray(file.read_bytes())
    first = rng.integers(len(data))
    data[first : first + 64] = bytes(len(data[first : first + 64]))
    file.write_bytes(data)


def noise(rng, file):
    file.write_bytes(rng.bytes(rng.integers(200)))


def folder_in_its_place(rng, file):
    file.unlink()
    file.mkdir()
    (file / "x").write_text("x")


def link_in_its_place(rng, file):
    """To what is outside, and is to stay as it is; or to nothing."""
    file.unlink()
    outside = file.parents[-1] if rng.integers(4) == 0 else OUTSIDE[0]
    file.symlink_to(outside if rng.integers(4) else "nowhere")


def pipe_in_its_place(rng, file):
    file.unlink()
    os.mkfifo(file)


def delete(rng, file):
    file.unlink()


def other_json(rng, file):
    """A value somewhere in it is another; in the manifest under a right checksum, as one who means harm has it."""
    if file.suffix != ".json":
        flip(rng, file)
        return
    data = json.loads(file.read_bytes())
    parent, keys = data, []
    while True:
        places = list(parent) if isinstance(parent, dict) else list(range(len(parent)))
        keys.append(places[rng.integers(len(places))])
        child = parent[keys[-1]]
        if not isinstance(child, dict | list) or not child or rng.integers(3) == 0:
            break
        parent = child
    value = VALUES[rng.integers(len(VALUES))]
    if isinstance(parent, dict) and rng.integers(3) == 0:
        parent[str(value) if rng.integers(2) else "../../outside.txt"] = parent.pop(keys[-1])
    elif rng.integers(10):
        parent[keys[-1]] = value
    else:
        data = value
    if file.name == "manifest.json" and isinstance(data, dict):
        data.pop("sha256", None)
        data["sha256"] = storage._checksum(data)
    file.write_text(json.dumps(data))


def strange_text(rng, file):
    text = file.read_bytes()
    place = rng.integers(len(text))
    more = [b"\0", b"9" * 500, b"[" * 5000, b"\xff\xfe", b"\xed\xa0\x80", b"1e999"][rng.integers(6)]
    file.write_bytes(text[:place] + more + text[place:])


DAMAGES = [
    flip,
    truncate,
    zeros,
    noise,
    folder_in_its_place,
    link_in_its_place,
    pipe_in_its_place,
    delete,
    other_json,
    strange_text,
]
OUTSIDE: list[Path] = []


def try_one(seed, made, scratch):
    """One file of a copy is damaged; then it is resumed, twice if it was refused. What happened, in words."""
    (folders, expected), rng = made, np.random.default_rng(seed)
    path = scratch / str(seed) / "a" / "run"
    shutil.copytree(folders[seed // 20 % 2], path)
    outside = path.parent.parent / "outside.txt"
    outside.write_text("outside")
    OUTSIDE[:] = [outside]
    files = sorted(file for file in path.rglob("*") if file.is_file() and file.name != disk.LOCK)
    damage = DAMAGES[seed % len(DAMAGES)]
    file = files[3 * (seed + seed // len(DAMAGES)) % len(files)]  # in the end each with each damage
    damage(rng, file)
    what = f"{seed}: {damage.__name__} {file.relative_to(path)}"
    try:
        runner.resume(path)
    except (InputError, RunError) as error:
        what += f" -> refused: {error}"
    except Exception as error:
        raise AssertionError(what) from error
    else:
        tiny.check_the_same(path, expected)
    assert outside.read_text() == "outside" and sorted(path.parents[1].iterdir()) == [path.parent, outside], (
        what
    )
    assert list(path.parent.iterdir()) == [path], what
    assert "\n" not in what
    shutil.rmtree(scratch / str(seed))
    return what


@pytest.mark.slow
@pytest.mark.parametrize("first", slow_but_first(range(0, TRIALS, 10)))
def test_damaged_folders(folders, tmp_path, first):
    """Broken once: checksums not looked at, what is no JSON not caught -> each fails; pipes read -> hangs."""
    with tiny.small():
        refused = ["refused" in try_one(seed, folders, tmp_path) for seed in range(first, first + 10)]
    assert sum(refused) < 10 / 2  # most are mended


if __name__ == "__main__":
    import tempfile
    import traceback

    import jax
    import jaxrl_tab.batch

    jax.config.update("jax_num_cpu_devices", 2)
    with tempfile.TemporaryDirectory() as place, tiny.small():
        made = make_folders(Path(place) / "made")
        for seed in range(int(sys.argv[1]), int(sys.argv[1]) + int(sys.argv[2])):
            try:
                print(try_one(seed, made, Path(place)), flush=True)
            except AssertionError:
                traceback.print_exc()
