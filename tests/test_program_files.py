"""What is kept is used only if this user wrote it here: files, their folder and the key, whatever happens to them."""

import contextlib
import errno
import hashlib
import hmac
import os
import resource
import stat
import subprocess
import sys
import threading
from functools import cache

import numpy as np
import pytest
from keeping import kept_in, look_again, plant, thing

from jaxrl_tab.engine import programs


@pytest.fixture
def file(programs_folder):
    """A file that is kept."""
    assert thing() and thing() is None
    (file,) = kept_in(programs_folder)
    return file


NOT_OURS = "it is damaged, or was not written here"


def refused(file, said, reason):
    """Whether it is said, in a line, that this file is not used and why; and it is made again."""
    assert thing()
    assert said() == [f"{file} is not used, and made again: {reason}"]
    assert thing() is None and said() == []
    return True


def test_every_damage_is_found(file, said):
    """Broken once: no checksum -> what is flipped is taken for the program."""
    whole = file.read_bytes()
    places = {0, len(whole) - 1, *np.random.default_rng(0).integers(len(whole), size=40).tolist()}
    damaged = [whole[:i] + bytes([whole[i] ^ 1 << i % 8]) + whole[i + 1 :] for i in places]
    damaged += [b"", whole[:10], whole[:32], whole[:-1], whole + b"\0", b"\0" * len(whole)]
    for data in damaged:
        file.write_bytes(data)
        assert refused(file, said, NOT_OURS)
        assert file.read_bytes() == whole


def test_the_checksum_is_bound_to_the_name(file, said, programs_folder):
    """What was written here, under the name of another. Broken once: without the name -> it is used."""
    assert thing("b", b"another")
    (other,) = (x for x in kept_in(programs_folder) if x != file)
    file.write_bytes(other.read_bytes())
    assert refused(file, said, NOT_OURS)


def test_the_checksum_is_as_documented(file):
    """Worked out here from RFC 2104, without `hmac`: a hash of a hash, each with the key in it."""
    key = (file.parent / "key").read_bytes().ljust(64, b"\0")
    inner, outer = (bytes(x ^ pad for x in key) for pad in (0x36, 0x5C))
    content = b"compiled" * 20
    checksum = hashlib.sha256(outer + hashlib.sha256(inner + file.name.encode() + content).digest()).digest()
    assert file.read_bytes() == checksum + content


def test_who_knows_the_format_but_not_the_key_is_refused(file, said):
    """Broken once: SHA-256 without a key -> the first of them is used."""
    forged = b"forged"
    named = file.name.encode() + forged
    key = b"\0" * 32
    for checksum in (hashlib.sha256(named), hmac.new(key, named, "sha256"), hmac.new(b"", named, "sha256")):
        file.write_bytes(checksum.digest() + forged)
        assert refused(file, said, NOT_OURS)


def somebody_else(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)


def test_what_others_may_have_written_is_not_read(file, said, tmp_path, monkeypatch):
    """Broken once: owner, rights or links not looked at -> what is planted is used."""
    for mode, number in ((0o622, "622"), (0o660, "660")):
        plant(file, b"planted")
        file.chmod(mode)
        assert refused(file, said, f"others may write it, too (its mode is {number}); remove it")
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    plant(file, b"planted")
    elsewhere = tmp_path / file.name
    file.rename(elsewhere)
    file.symlink_to(elsewhere)
    assert refused(file, said, os.strerror(errno.ELOOP)) and elsewhere.exists()
    plant(file, b"planted")
    with monkeypatch.context() as patched:
        somebody_else(patched)
        assert thing()
    assert said() == [f"{file} is not used, and made again: it belongs to another user ({os.getuid()})"]
    plant(file, b"planted")
    file.chmod(0o644)  # but others may read it; and what was written with the user's key is the user's
    assert programs.kept("a", lambda: b"made", bytes, bytes) == b"planted" and said() == []


def check_unused(folder, said, reason):
    """That nothing is read or written there, and a line says why: once, for all that is kept."""
    look_again()
    before = {path: path.is_file() and path.read_bytes() for path in folder.iterdir()}
    assert thing() and thing("b")
    assert said() == [f"compiled programs are not kept in {folder}: {reason}"]
    assert before == {path: path.is_file() and path.read_bytes() for path in folder.iterdir()}


def test_nothing_is_read_in_a_folder_that_others_may_write(file, said, tmp_path, monkeypatch):
    """Nor written. Broken once: the folder not looked at -> what is planted is used."""
    plant(file, b"planted")
    folder = file.parent
    folder.chmod(0o777)
    check_unused(folder, said, "others may write it, too (its mode is 777); remove it")
    folder.chmod(0o700)
    with monkeypatch.context() as patched:
        somebody_else(patched)
        check_unused(folder, said, f"it belongs to another user ({os.getuid()})")
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    check_unused(folder, said, "it is a link, or of another kind")
    folder.unlink()
    folder.write_text("")
    look_again()
    assert thing() and said() == [f"compiled programs are not kept in {folder}: {os.strerror(errno.EEXIST)}"]


# --- the key -----------------------------------------------------------------------------------------


@pytest.fixture
def key(file):
    return file.parent / "key"


def test_each_folder_has_a_key_of_its_own_that_only_the_user_may_read(key, tmp_path, monkeypatch):
    """Broken once: a constant key -> fails."""
    assert stat.S_IMODE(key.stat().st_mode) == 0o600 and len(key.read_bytes()) == 32
    assert key.stat().st_nlink == 1
    programs.keep(tmp_path / "other")
    assert thing()
    assert (tmp_path / "other" / "programs" / "key").read_bytes() != key.read_bytes()


def test_a_key_that_is_gone_or_another_makes_all_anew(key, file, said):
    """Broken once: checksums without the key -> what was written with the old one is used."""
    first = key.read_bytes()
    key.unlink()
    look_again()
    assert refused(file, said, NOT_OURS)
    assert len(key.read_bytes()) == 32 and key.read_bytes() != first
    key.write_bytes(first[::-1])
    look_again()
    assert refused(file, said, NOT_OURS) and key.read_bytes() == first[::-1]


def test_with_a_key_that_is_not_the_users_alone_nothing_is_kept(key, said, tmp_path, monkeypatch):
    """Broken once: each of these not looked at -> what is there is used, or overwritten."""
    unusable = "the key in it cannot be used: "
    whole = key.read_bytes()
    for wrong in (b"", whole[:31], whole + b"\0"):
        key.write_bytes(wrong)
        check_unused(key.parent, said, f"{unusable}it has {len(wrong)} bytes instead of 32; remove it")
    key.write_bytes(whole)
    for mode, verb in ((0o644, "read"), (0o640, "read"), (0o604, "read"), (0o620, "write"), (0o666, "write")):
        key.chmod(mode)
        reason = f"others may {verb} it, too (its mode is {mode:o}); remove it"
        check_unused(key.parent, said, unusable + reason)
    key.chmod(0o600)
    with monkeypatch.context() as patched:
        somebody_else(patched)
        patched.setattr(programs, "_is_usable", cache(lambda _: True))  # the folder is the user's
        check_unused(key.parent, said, f"{unusable}it belongs to another user ({os.getuid()})")
    key.rename(tmp_path / "key")
    for target in (tmp_path / "key", tmp_path / "nothing"):
        key.symlink_to(target)
        check_unused(key.parent, said, unusable + os.strerror(errno.ELOOP))
        key.unlink()
    assert not (tmp_path / "nothing").exists()
    (tmp_path / "key").rename(key)
    look_again()
    assert thing() is None and said() == []


def test_of_two_that_make_a_key_the_slower_takes_that_of_the_faster(key, monkeypatch):
    """It was not there when the slower one looked. Broken once: it replaces what is there -> fails."""
    first = key.read_bytes()
    monkeypatch.setattr(os.path, "lexists", lambda _: False)
    look_again()
    assert thing() is None and key.read_bytes() == first
    assert len(list(key.parent.iterdir())) == 2


# --- files -------------------------------------------------------------------------------------------


def test_the_oldest_go_and_no_files_of_others(programs_folder, monkeypatch):
    """Broken once: all names -> they are gone. What a process left that died is removed after an hour."""
    monkeypatch.setattr(programs, "AT_MOST", 2)
    programs_folder.mkdir(0o700)
    own = "0123456789abcdef" * 4
    others = {"thesis.tex", own, f"{own}.txt", f"{own}.program~", f".{own}.program", f"{own[1:]}.program"}
    left, young = f"{own}.program.abc", f"{own}.program.def"
    for name in (*others, left, young):
        (programs_folder / name).write_text("")
        os.utime(programs_folder / name, (0, 0))
    os.utime(programs_folder / young)
    abandoned = programs_folder / "key.abc"
    abandoned.write_text("")
    os.utime(abandoned, (0, 0))
    for i in range(4):
        assert thing(i)
    assert (programs_folder / "key").exists() and not abandoned.exists()
    names = {path.name for path in kept_in(programs_folder)}
    assert names > {*others, young} and left not in names and len(names - others) == 3
    assert thing(3) is None and thing(0)


def test_on_the_disk_before_it_has_its_name(programs_folder, monkeypatch):
    """The key as well. Broken once: no fsync -> fails."""
    happened, fsync, replace, link = [], os.fsync, os.replace, os.link
    monkeypatch.setattr(os, "fsync", lambda x: happened.append(f"{os.fstat(x).st_size}") or fsync(x))
    monkeypatch.setattr(os, "replace", lambda *x: happened.append("named") or replace(*x))
    monkeypatch.setattr(os, "link", lambda *x: happened.append("linked") or link(*x))
    assert thing()
    (file,) = kept_in(programs_folder)
    assert happened == ["32", "linked", f"{file.stat().st_size}", "named"]


@pytest.mark.parametrize("fails", ["fsync", "replace", "write", "a small disk"])
def test_a_full_disk_is_one_line_and_leaves_nothing(file, said, monkeypatch, fails):
    folder = file.parent
    file.unlink()

    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        reason = os.strerror(errno.ENOSPC)
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        if fails == "a small disk":  # for this process
            reason = os.strerror(errno.EFBIG)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        elif fails == "write":
            patched.setattr(programs.tempfile, "mkstemp", full)
        else:
            patched.setattr(os, fails, full)
        try:
            assert thing() and thing("b")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert said() == [f"compiled programs are not kept in {folder}: {reason}"]
    assert kept_in(folder) == []
    assert thing() and thing() is None


@pytest.mark.parametrize(
    ("fails", "number"), [("fsync", errno.ENOSPC), ("mkstemp", errno.ENOSPC), ("link", errno.EPERM)]
)
def test_where_no_key_can_be_written_it_works_without(programs_folder, said, monkeypatch, fails, number):
    """A full disk, or one without links. Broken once: the error not caught -> fails."""
    programs_folder.mkdir(0o700)

    def refuse(*_, **__):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patched:
        patched.setattr(programs.tempfile if fails == "mkstemp" else os, fails, refuse)
        check_unused(programs_folder, said, f"the key in it cannot be used: {os.strerror(number)}")
    look_again()
    assert thing() and thing() is None


def test_several_at_once_read_what_is_whole(programs_folder, monkeypatch):
    """And make room for each other."""
    monkeypatch.setattr(programs, "AT_MOST", 3)
    programs_folder.mkdir(0o700)
    files = [programs_folder / f"{i:064x}.program" for i in range(6)]
    failed, key = [], b"a key"

    def at_work(random):
        try:
            for i in random.integers(len(files), size=60):
                data = bytes([i]) * 10_000
                if random.random() < 0.5:
                    programs._write(files[i], key, data)
                else:
                    with contextlib.suppress(FileNotFoundError):
                        assert programs._read(files[i], key) == data
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=at_work, args=[np.random.default_rng(i)]) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert {path.name for path in programs_folder.iterdir()} <= {file.name for file in files}


@pytest.mark.slow
def test_two_processes_at_once_agree_on_a_key_and_read_what_is_whole(tmp_path):
    """Each makes a key in the folders where the other does, and reads what the other writes.

    Broken once: a key that replaces what is there -> they have two. Written under its own name from the start ->
    damaged.
    """
    code = (
        "import sys; from pathlib import Path; from jaxrl_tab.engine import programs;"
        "file, mine = Path(sys.argv[1]), sys.argv[2].encode() * 500_000; whole = {b'1' * 500_000, b'2' * 500_000}\n"
        "programs._write(file, b'key', mine); print('ready', flush=True); sys.stdin.readline()\n"
        "for i in range(50): print(programs._key(file.parent / str(i)).hex())\n"
        "for _ in range(100): programs._write(file, b'key', mine); assert programs._read(file, b'key') in whole"
    )
    given = [sys.executable, "-c", code, str(tmp_path / f"{'0' * 64}.program")]
    with contextlib.ExitStack() as ends:
        started = [
            ends.enter_context(
                subprocess.Popen([*given, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            )
            for name in "12"
        ]
        for process in started:
            assert process.stdout.readline() == "ready\n"
        for process in started:
            process.stdin.write("go\n")
            process.stdin.flush()
        keys = [[process.stdout.readline() for _ in range(50)] for process in started]
        assert [process.wait(60) for process in started] == [0, 0]
    assert keys[0] == keys[1] and len(set(keys[0])) == 50
    assert [len(list((tmp_path / str(i)).iterdir())) for i in range(50)] == [1] * 50
    assert len(list(tmp_path.iterdir())) == 51
