"""Compiled programs that outlive the process: found again, never taken for another, trusted only if our own."""

import contextlib
import errno
import os
import pickle
import resource
import stat
import subprocess
import sys
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrl_tab as rl
from jaxrl_tab import batch
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.engine import programs, provenance, room

BUDGET = {"num_steps": 40, "log_every": 20}


@pytree
class Stranger(rl.QLearning):
    """A method whose code is not in the package."""


def strange_record(state):
    """A function whose code is not in the package, either."""
    return {"largest": jnp.max(state.q)}


def forget():
    """As a new process would."""
    for cached in (room._needs, room.traced_program, batch._compiled, programs._is_usable, programs._warn):
        cached.cache_clear()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", None)  # and back again after the test
    programs.keep(tmp_path)
    forget()
    yield tmp_path / "programs"
    forget()


def swept(method="q-learning", **grid):
    return rl.sweep(rl.make("random-walk"), method, {"epsilon": 0.25} | grid, num_seeds=3, **BUDGET)


def test_a_second_process_neither_traces_nor_compiles_and_has_the_same_bits(folder, monkeypatch):
    """Also with other values of the hyperparameters, which are no part of the program. Broken once: a name

    without the budget finds a program with other shapes.
    """
    first = swept(alpha=[0.5, 0.25])
    assert len(list(folder.iterdir())) == 2  # what it needs, and the program
    forget()
    with monkeypatch.context() as patched:
        for module in (batch, room):
            patched.setattr(module, "traced_program", lambda *_: pytest.fail("it was traced"))
        again = swept(alpha=[0.5, 0.75])
    np.testing.assert_array_equal(first.q[0], again.q[0])
    np.testing.assert_array_equal(first.log.rewards[0], again.log.rewards[0])
    assert (first.q[1] != again.q[1]).any()
    other = rl.sweep(rl.make("random-walk"), "q-learning", num_seeds=3, num_steps=60, log_every=20)
    assert other.log.steps.shape == (3, 3)
    assert len(list(folder.iterdir())) == 4


def test_what_jax_itself_kept_is_not_written_down_again(folder):
    """The same program was compiled before without `keep`, and JAX has it in its own cache. Broken once:

    under one name for both, what is found a third time cannot be called.
    """
    programs._folder = None
    first = swept()
    for _ in range(2):
        forget()
        programs._folder = folder
        np.testing.assert_array_equal(swept().q, first.q)


def test_the_code_of_others_may_change_so_its_programs_are_not_kept(folder):
    """Broken once: functions looked at by their type, which is Python's -> the second is kept."""
    swept(Stranger)
    for record in (lambda state: {"largest": jnp.max(state.q)}, strange_record):
        rl.sweep(rl.make("random-walk"), "q-learning", num_seeds=2, **BUDGET, record=record)
    assert not folder.exists()


def test_what_calls_into_this_process_is_not_kept():
    program = jax.jit(lambda x: jax.pure_callback(np.sin, x, x)).lower(jnp.zeros(2)).compile()
    with pytest.raises(ValueError, match="in another process there may be no xla_"):
        batch._pack(program)


def test_settings_and_sources_are_part_of_the_name(folder, monkeypatch):
    name = programs._file("a")
    assert name == programs._file("a") != programs._file("b")
    monkeypatch.setenv("XLA_FLAGS", "--xla_another=1")
    assert programs._file("a") != name
    monkeypatch.undo()
    monkeypatch.setattr(programs, "_code_and_machine", lambda: b"another version")
    monkeypatch.setattr(programs, "_folder", folder)
    assert programs._file("a").parent == folder and programs._file("a") != name


def test_another_version_and_another_processor_have_other_programs(folder, monkeypatch):
    names = {programs._file("a")}
    installed = provenance.installed()
    for name, value in {
        "installed": lambda: installed | {"jaxlib": "9.9"},
        "features": lambda: ["avx9"],
    }.items():
        with monkeypatch.context() as patched:
            patched.setattr(provenance, name, value)
            programs._code_and_machine.cache_clear()
            names.add(programs._file("a"))
    programs._code_and_machine.cache_clear()
    with jax.default_matmul_precision("highest"):  # of this thread alone
        names.add(programs._file("a"))
    assert len(names) == 4


def test_where_nobody_asked_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", None)
    assert programs._file("a") is None


# --- what is trusted ---------------------------------------------------------------------------------


def thing(name="a", value=b"compiled" * 20):
    """What is kept under a name; or `None`, where it was there already."""
    made = []
    found = programs.kept(name, lambda _: made.append(value) or value, pack=lambda x: x, unpack=lambda x: x)
    assert found == value
    return value if made else None


@pytest.fixture
def said(caplog):
    """The lines that were said since this was last called, each of which is said once in a process."""

    def lines():
        found = [record.getMessage() for record in caplog.records]
        caplog.clear()
        programs._warn.cache_clear()
        return found

    return lines


@pytest.fixture
def file(folder):
    """A file that is kept."""
    assert thing() and thing() is None
    (file,) = folder.iterdir()
    return file


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
        assert refused(file, said, "it is damaged")
        assert file.read_bytes() == whole


def test_the_checksum_is_bound_to_the_name(file, said, folder):
    """A whole program under the name of another."""
    assert thing("b", b"another")
    (other,) = (x for x in folder.iterdir() if x != file)
    file.write_bytes(other.read_bytes())
    assert refused(file, said, "it is damaged")


class Planted:
    """A pickle that does something."""

    def __init__(self, mark):
        self.mark = str(mark)

    def __reduce__(self):
        return Path.touch, (Path(self.mark),)


def plant(file, mark):
    """Puts it there, with its checksum: that anybody can work out."""
    data = pickle.dumps(Planted(mark))
    file.write_bytes(programs._checksum(file, data) + data)
    file.chmod(0o600)


def somebody_else(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)


def test_what_others_may_have_written_is_not_read(file, said, tmp_path, monkeypatch):
    """Broken once: owner, rights or links not looked at -> what is planted is executed."""
    mark = tmp_path / "executed"
    for mode, number in ((0o622, "622"), (0o660, "660")):
        plant(file, mark)
        file.chmod(mode)
        assert refused(file, said, f"others may write it, too (its mode is {number}); remove it")
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    elsewhere = tmp_path / file.name
    plant(elsewhere, mark)
    file.unlink()
    file.symlink_to(elsewhere)
    assert refused(file, said, os.strerror(errno.ELOOP)) and elsewhere.exists()
    plant(file, mark)
    with monkeypatch.context() as patched:
        somebody_else(patched)
        assert thing()
    assert said() == [f"{file} is not used, and made again: it belongs to another user ({os.getuid()})"]
    assert not mark.exists()
    plant(file, mark)  # but what the user may write as the user is the user's
    with pytest.raises(AssertionError):
        thing()
    assert mark.exists()


def test_nothing_is_read_in_a_folder_that_others_may_write(file, said, tmp_path, monkeypatch):
    """Nor written; said once for all programs. Broken once: the folder not looked at -> executed."""
    mark = tmp_path / "executed"
    plant(file, mark)
    folder = file.parent
    kept = f"compiled programs are not kept in {folder}: "

    def unused(reason):
        programs._is_usable.cache_clear()
        before = {path: path.read_bytes() for path in folder.iterdir()}
        assert thing() and thing("b")
        assert said() == [kept + reason]
        assert before == {path: path.read_bytes() for path in folder.iterdir()}

    folder.chmod(0o777)
    unused("others may write it, too (its mode is 777); remove it")
    folder.chmod(0o700)
    with monkeypatch.context() as patched:
        somebody_else(patched)
        unused(f"it belongs to another user ({os.getuid()})")
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    unused("it is a link, or of another kind")
    folder.unlink()
    folder.write_text("")
    programs._is_usable.cache_clear()
    assert thing() and said() == [kept + os.strerror(errno.EEXIST)]
    assert not mark.exists()


def test_a_folder_for_all_has_one_in_it_for_the_user(tmp_path, monkeypatch):
    """JAX_COMPILATION_CACHE_DIR of mode 777."""
    (tmp_path / "all").mkdir()
    (tmp_path / "all").chmod(0o777)
    monkeypatch.setattr(programs, "_folder", None)
    programs.keep(tmp_path / "all")
    assert thing() and thing() is None
    assert stat.S_IMODE((tmp_path / "all" / "programs").stat().st_mode) == 0o700


# --- files -------------------------------------------------------------------------------------------


def test_the_oldest_go_and_no_files_of_others(folder, monkeypatch):
    """Broken once: all names -> they are gone. What a process left that died is removed after an hour."""
    monkeypatch.setattr(programs, "AT_MOST", 2)
    folder.mkdir(0o700)
    own = "0123456789abcdef" * 4
    others = {"thesis.tex", own, f"{own}.txt", f"{own}.program~", f".{own}.program", f"{own[1:]}.program"}
    left, young = f"{own}.program.abc", f"{own}.program.def"
    for name in (*others, left, young):
        (folder / name).write_text("")
        os.utime(folder / name, (0, 0))
    os.utime(folder / young)
    for i in range(4):
        assert thing(i)
    names = {path.name for path in folder.iterdir()}
    assert names > {*others, young} and left not in names and len(names - others) == 3
    assert thing(3) is None and thing(0)


def test_on_the_disk_before_it_has_its_name(folder, monkeypatch):
    """Broken once: no fsync -> fails."""
    happened, fsync, replace = [], os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda x: happened.append(f"{os.fstat(x).st_size}") or fsync(x))
    monkeypatch.setattr(os, "replace", lambda *x: happened.append("named") or replace(*x))
    assert thing()
    (file,) = folder.iterdir()
    assert happened == [f"{file.stat().st_size}", "named"]


@pytest.mark.parametrize("fails", ["fsync", "replace", "write", "a small disk"])
def test_a_full_disk_is_one_line_and_leaves_nothing(folder, said, monkeypatch, fails):
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
    assert list(folder.iterdir()) == []
    assert thing() and thing() is None


def test_several_at_once_read_what_is_whole(folder, monkeypatch):
    """And make room for each other."""
    monkeypatch.setattr(programs, "AT_MOST", 3)
    folder.mkdir(0o700)
    files = [folder / f"{i:064x}.program" for i in range(6)]
    failed = []

    def at_work(random):
        try:
            for i in random.integers(len(files), size=60):
                data = bytes([i]) * 10_000
                if random.random() < 0.5:
                    programs._write(files[i], data)
                else:
                    with contextlib.suppress(FileNotFoundError):
                        assert programs._read(files[i]) == data
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=at_work, args=[np.random.default_rng(i)]) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert {path.name for path in folder.iterdir()} <= {file.name for file in files}


@pytest.fixture
def default(monkeypatch):
    """`keep` with nothing chosen; and JAX as it was, afterwards."""
    names = "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"
    with provenance.using({name: jax.config.values[name] for name in names}):
        jax.config.update("jax_compilation_cache_dir", None)
        monkeypatch.setattr(programs, "_folder", None)
        forget()
        yield lambda: programs.keep() or jax.config.values["jax_compilation_cache_dir"]


def test_the_folder_of_jax_is_for_the_user_alone_too(default, tmp_path, monkeypatch, said):
    """Where it is ours: what JAX keeps there is as executable. Another one is not used, and it is said."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    ours = tmp_path / "cache" / "jaxrl_tab"
    assert default() == str(ours) and stat.S_IMODE(ours.stat().st_mode) == 0o700 and thing()
    jax.config.update("jax_compilation_cache_dir", None)
    ours.chmod(0o775)
    forget()
    monkeypatch.setattr(programs, "_folder", None)
    assert default() is None and thing() and thing()
    reason = "others may write it, too (its mode is 775); remove it"
    assert said() == [f"compiled programs are not kept in {ours}: {reason}"]


def test_where_no_folder_can_be_made_it_works_without(default, tmp_path, monkeypatch, said):
    """A cache folder that is a file, a home that is none, and no home at all."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert default() is None and thing()
    not_a_folder = os.strerror(errno.ENOTDIR)
    assert said() == [f"compiled programs are not kept in {tmp_path}/file/jaxrl_tab: {not_a_folder}"]
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/dev/null")
    assert default() is None and thing()
    assert said() == [f"compiled programs are not kept in /dev/null/.cache/jaxrl_tab: {not_a_folder}"]

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    assert default() is None and thing()
    assert said() == ["compiled programs are not kept: Could not determine home directory."]


def test_two_processes_keep_the_same_program_at_once(tmp_path):
    """Each reads the other's while it writes. Broken once: written under its own name from the start -> damaged."""
    code = (
        "import sys; from pathlib import Path; from jaxrl_tab.engine import programs;"
        "file, mine = Path(sys.argv[1]), sys.argv[2].encode() * 500_000; whole = {b'1' * 500_000, b'2' * 500_000}\n"
        "programs._write(file, mine); print('ready', flush=True); sys.stdin.readline()\n"
        "for _ in range(100): programs._write(file, mine); assert programs._read(file) in whole"
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
        assert [process.wait(60) for process in started] == [0, 0]
    assert len(list(tmp_path.iterdir())) == 1
