"""Shards and their manifest: whole or not there, and every damage found."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxrl_tab.core.errors import InputError, RunError
from jaxrl_tab.experiment import disk, storage
from jaxrl_tab.experiment.storage import Store

ARRAYS = {"q": np.arange(6, dtype=np.float32).reshape(1, 2, 3), "seconds": np.array([0.5, 0.25])}


@pytest.fixture
def folder(tmp_path):
    """A folder with three shards, and a file made of them."""
    with disk.new_folder(tmp_path / "run") as new:
        Store.begin(new, "abc")
    store = Store(tmp_path / "run", "abc")
    for number in range(3):
        store.write(number, ARRAYS, diverged=number)
    (store.path / "results.nc").write_bytes(b"results")
    store.keep_files(["results.nc"])
    return store.path


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


WHOLE = ["manifest.json", "results.nc", *(f"shards/00000{i}.npz" for i in range(3))]


def test_what_is_kept_is_there_again(folder):
    store = Store(folder, "abc")
    assert store.problems == [] and names(folder) == WHOLE
    assert {number: facts.diverged for number, facts in store.shards.items()} == {0: 0, 1: 1, 2: 2}
    read = store.read(1)
    assert list(read) == list(ARRAYS)
    for name, x in read.items():
        np.testing.assert_array_equal(x, ARRAYS[name])
        assert x.dtype == ARRAYS[name].dtype
    assert store.files == ["results.nc"]


def truncated(file):
    os.truncate(file, file.stat().st_size * 2 // 3)


def empty(file):
    os.truncate(file, 0)


def flipped(bit):
    """Flips one bit, so far from the beginning (as a share of the whole)."""

    def damage(file):
        data = bytearray(file.read_bytes())
        data[int(bit * (len(data) - 1))] ^= 16
        file.write_bytes(data)

    return damage


DAMAGES = [truncated, empty, *map(flipped, (0, 0.1, 0.3, 0.5, 0.7, 0.9, 1))]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_shard_is_named_and_set_aside(folder, damage):
    """Broken once: its checksum not looked at -> fails."""
    damage(folder / "shards" / "000001.npz")
    store = Store(folder, "abc")
    (line,) = store.problems
    assert line == "shards/000001.npz is damaged: it is now set-aside/0-000001.npz, and is computed again"
    assert sorted(store.shards) == [0, 2]
    assert names(folder) == [WHOLE[0], WHOLE[1], "set-aside/0-000001.npz", WHOLE[2], WHOLE[4]]
    store.write(1, ARRAYS)
    assert Store(folder, "abc").problems == []


def test_a_missing_shard_and_a_damaged_result_are_named(folder):
    (folder / "shards" / "000002.npz").unlink()
    (folder / "results.nc").write_bytes(b"resultz")
    store = Store(folder, "abc")
    assert store.problems == [
        "shards/000002.npz is missing: it is computed again",
        "results.nc is damaged: it is now set-aside/0-results.nc, and is made again",
    ]
    assert sorted(store.shards) == [0, 1] and store.files == []


@pytest.mark.parametrize("damage", [*DAMAGES, lambda file: file.unlink()])
def test_a_damaged_manifest_is_made_again_of_the_shards(folder, damage):
    """No shard is computed again that is whole."""
    before = Store(folder, "abc").shards
    damage(folder / "manifest.json")
    store = Store(folder, "abc")
    assert len(store.problems) == 1 and store.problems[0].startswith("manifest.json is ")
    assert store.shards == before and store.files == []
    assert Store(folder, "abc").problems == []


def test_a_manifest_that_says_otherwise_is_damaged(folder):
    """In a way that only its own checksum tells. Broken once: that not looked at -> fails."""
    file = folder / "manifest.json"
    file.write_text(file.read_text().replace('"diverged": 2', '"diverged": 3'))
    store = Store(folder, "abc")
    assert len(store.problems) == 1 and store.problems[0].startswith("manifest.json is damaged")
    assert store.shards[2].diverged == 2


@pytest.mark.parametrize("damage", DAMAGES)
def test_without_a_manifest_damaged_shards_are_still_found(folder, damage):
    """By the checksums in the file. A bit that belongs to none may be another, if all arrays are the same."""
    (folder / "manifest.json").unlink()
    damage(folder / "shards" / "000001.npz")
    store = Store(folder, "abc")
    if 1 in store.shards:
        assert all((store.read(1)[name] == x).all() for name, x in ARRAYS.items())
    else:
        assert any(line.startswith("shards/000001.npz is damaged") for line in store.problems)
    assert {0, 2} <= set(store.shards)


def test_a_shard_whose_place_in_the_manifest_was_not_written_is_there(folder):
    """As where the process is killed between the two."""
    manifest = (folder / "manifest.json").read_bytes()
    Store(folder, "abc").write(3, ARRAYS, diverged=7)
    (folder / "manifest.json").write_bytes(manifest)
    store = Store(folder, "abc")
    assert store.problems == [] and store.shards[3].diverged == 7


def test_shards_of_another_experiment_are_set_aside(folder):
    """Even under the right name. Broken once: the fingerprint not looked at -> fails."""
    other = folder.parent / "other"
    other.mkdir()
    Store(other, "xyz").write(3, ARRAYS)
    (other / "shards" / "000003.npz").rename(folder / "shards" / "000003.npz")
    (folder / "shards" / "000000.npz").rename(folder / "shards" / "000004.npz")
    store = Store(folder, "abc")
    assert sorted(store.shards) == [1, 2]
    assert len(store.problems) == 3
    assert Store(other, "abc").problems[0].startswith("manifest.json is of another experiment")


def test_what_was_being_written_is_gone(folder):
    (folder / "shards" / f".000003.npz{disk.UNFINISHED}").write_bytes(b"half")
    (folder / f".pictures{disk.UNFINISHED}").mkdir()
    (folder / f".pictures{disk.UNFINISHED}" / "x.png").write_bytes(b"half")
    assert Store(folder, "abc").problems == [] and names(folder) == WHOLE


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_where_the_disk_is_full_nothing_is_half_there(folder, monkeypatch, call):
    """One line, no file under the final name, no rest; and what was there before is still."""
    store, before = Store(folder, "abc"), (folder / "manifest.json").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, call, full)
        with pytest.raises(RunError) as error:
            store.write(3, ARRAYS)
    assert str(error.value) == f"{folder}/shards/000003.npz could not be written: No space left on device"
    assert names(folder) == WHOLE and (folder / "manifest.json").read_bytes() == before
    store.write(3, ARRAYS)
    assert sorted(Store(folder, "abc").shards) == [0, 1, 2, 3]


@pytest.mark.parametrize("there", [".", "", "..", "/"])
def test_a_new_folder_is_none_that_has_no_name_of_its_own(there):
    with (
        pytest.raises(InputError, match="exists already; name a new folder"),
        disk.new_folder(Path(there)),
    ):
        pass


def test_a_new_folder_may_keep_what_was_finished_and_say_where(tmp_path):
    """Broken once: without a look at whether there is anything -> fails."""
    with pytest.raises(KeyboardInterrupt), disk.new_folder(tmp_path / "empty", keep=True):
        raise KeyboardInterrupt

    def stopped():
        with disk.new_folder(tmp_path / "run", keep=True) as new:
            (new / "file").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stop:
        stopped()
    (kept,) = tmp_path.iterdir()
    assert stop.value.__notes__ == [f"what was finished is in {kept}"]
    assert (kept / "file").read_text() == "x"


def test_a_new_folder_is_there_with_all_its_files_or_not_at_all(tmp_path):
    path = tmp_path / "a" / "run"

    def make(then=lambda: None):
        with disk.new_folder(path) as new:
            (new / "file").write_text("x")
            assert not path.exists()
            then()

    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(stop)
    assert names(tmp_path) == []
    make()
    assert names(tmp_path) == ["a/run/file"]
    with pytest.raises(InputError, match="exists already; name a new folder"):
        make()
    path /= "file/x"
    with pytest.raises(InputError, match="cannot be made: Not a directory"):
        make()


def test_of_two_who_make_the_same_folder_one_does(tmp_path):
    """Broken once: what is there replaced -> fails."""

    def slow(path):
        with disk.new_folder(path) as new:
            (new / "file").write_text("slow")
            path.mkdir()
            (path / "file").write_text("quick")

    with pytest.raises(InputError, match="exists already"):
        slow(tmp_path / "run")
    assert (tmp_path / "run" / "file").read_text() == "quick" and names(tmp_path) == ["run/file"]


def test_a_locked_folder_is_refused(tmp_path):
    """Also within one process. A lock that is a link, or no file, is refused too. Broken once: no lock -> fails."""

    def enter():
        with disk.lock(tmp_path):
            pass

    with disk.lock(tmp_path), pytest.raises(InputError, match="another process is at work in"):
        enter()
    enter()
    file = tmp_path / disk.LOCK
    file.unlink()
    file.symlink_to(tmp_path / "outside")
    with pytest.raises(InputError, match=r"\.lock cannot be written: Too many levels of symbolic links"):
        enter()
    assert not (tmp_path / "outside").exists()
    file.unlink()
    file.mkdir()
    with pytest.raises(InputError, match=r"\.lock cannot be written: Is a directory"):
        enter()


def test_a_process_that_is_killed_leaves_no_lock(tmp_path):
    """Broken once: a file made with O_EXCL in place of a lock -> fails."""
    hold = (
        "import pathlib, sys; from jaxrl_tab.experiment import disk, storage\n"
        "with disk.lock(pathlib.Path(sys.argv[1])): print('at work', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", hold, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout and process.stdout.readline() == "at work\n"
        with pytest.raises(InputError, match="another process is at work in"), disk.lock(tmp_path):
            pass
        process.kill()
    with disk.lock(tmp_path):
        assert (tmp_path / disk.LOCK).exists()


def test_the_manifest_is_plain_json(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    assert list(manifest) == ["fingerprint", "shards", "files", "sha256"]
    assert list(manifest["shards"]["000002.npz"]) == ["sha256", "diverged", "setting", "surroundings"]


def test_names_in_a_manifest_lead_nowhere_else(folder):
    """Even where its checksum is right. Broken once: names not looked at -> outside.txt is set aside."""
    outside = folder.parent / "outside.txt"
    outside.write_text("outside")
    shard = {"../../outside.txt": {"sha256": "0" * 64, "diverged": 0, "setting": None}}
    files = ({"../outside.txt": "0" * 64}, {str(outside): "0" * 64})
    for names in (*({"files": x} for x in files), {"shards": shard}):
        manifest = storage.read_manifest(folder)
        assert manifest
        storage._write_manifest(folder, manifest | names)
        assert Store(folder, "abc").problems[0].startswith("manifest.json is damaged")
    assert outside.read_text() == "outside"


@pytest.mark.parametrize("place", ["shards", "set-aside", "pictures"])
def test_folders_that_are_links_are_refused(folder, tmp_path, place):
    """Broken once: links not looked at -> what is outside is removed."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / f".x{disk.UNFINISHED}").write_text("outside")
    (folder / "shards" / "000001.npz").write_bytes(b"damaged")
    if (folder / place).exists():
        (folder / place).rename(folder / "elsewhere")
    (folder / place).symlink_to(tmp_path / "outside")
    with pytest.raises(InputError, match=f"{place} is a link: put the folder that it leads to in its place"):
        Store(folder, "abc")
    assert [x.name for x in (tmp_path / "outside").iterdir()] == [f".x{disk.UNFINISHED}"]


def test_a_whole_shard_tells_its_shapes_and_can_be_left_out(folder):
    """Broken once: it was called damaged -> fails."""
    store = Store(folder, "abc")
    assert store.shapes(1) == {name: (x.shape, x.dtype) for name, x in ARRAYS.items()}
    store.leave_out(1)
    assert 1 not in store.shards and store.problems == [
        "shards/000001.npz is not as this version writes it: it is now set-aside/0-000001.npz, and is computed again"
    ]


LABELS = [
    "walk",
    "Walk",
    "a,moves=king",
    "x" * 300,
    "x" * 301,
    "a.unfinished",
    "con",
    "CON.x",
    "lpt1",
    "a.",
    "a ",
    "a",
]
LABELS += [
    "\u00fc",
    "\u4e16\u754c",
    "a:b",
    "a?b",
    "a*b",
    "x-01234567",
    "a\\b",
    "_",
    "\ud800b",
    "x" * 60,
    "x" * 61,
]


def test_labels_give_names_of_files():
    """Broken once: case not looked at, length not looked at -> fails."""
    names = disk.file_names(LABELS)
    assert len({name.lower() for name in names.values()}) == len(names) == len(LABELS)
    for name in names.values():
        assert 0 < len(name) < 80 and name.isascii() and name[0] not in ".-" and name[-1] not in ". "
        assert not set(name) & set('<>:"/\\|?* ') and storage._is_result_file(f"pictures/{name}/overview.png")
        assert name.partition(".")[0].lower() not in {"con", "prn", "aux", "nul", "com1", "lpt1"}
    assert names["a,moves=king"] == "a,moves=king" and names["walk"] != "walk"
    assert names["a.unfinished"] == "a.unfinished"  # which is finished: what is not begins with a dot
