"""What outlives the process: found again, never taken for something else, used only if it was written here."""

import ast
import errno
import os
import pickle
import platform
import stat
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from keeping import forget, kept_in, plant, thing

import jaxrl_tab as rl
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.engine import by_lanes, programs, provenance, room
from jaxrl_tab.engine.budget import Budget
from jaxrl_tab.envs import ENVS
from jaxrl_tab.lanes import machine
from jaxrl_tab.methods import ALGORITHMS, PREDICTION

BUDGET = {"num_steps": 40, "log_every": 20}


@pytree
class Stranger(rl.QLearning):
    """A method whose code is not in the package."""


def strange_record(state):
    """A function whose code is not in the package, either."""
    return {"largest": jnp.max(state.q)}


def swept(method="q-learning", **grid):
    return rl.sweep(rl.make("random-walk"), method, {"epsilon": 0.25} | grid, num_seeds=3, **BUDGET)


def test_a_second_process_traces_nothing_and_has_the_same_bits(programs_folder, monkeypatch):
    """Also with other values of the hyperparameters, which are no part of the name. Broken once: a name without

    the budget finds other shapes.
    """
    first = swept(alpha=[0.5, 0.25])
    assert len(kept_in(programs_folder)) == 1
    forget()
    with monkeypatch.context() as patched:
        patched.setattr(room, "traced_program", lambda *_: pytest.fail("it was traced"))
        patched.setattr(by_lanes, "traced_program", room.traced_program)
        again = swept(alpha=[0.5, 0.75])
    np.testing.assert_array_equal(first.q[0], again.q[0])
    np.testing.assert_array_equal(first.log.rewards[0], again.log.rewards[0])
    assert (first.q[1] != again.q[1]).any()
    other = rl.sweep(rl.make("random-walk"), "q-learning", num_seeds=3, num_steps=60, log_every=20)
    assert other.log.steps.shape == (3, 3)
    assert len(kept_in(programs_folder)) == 2


def test_the_code_of_others_may_change_so_its_programs_are_not_kept(programs_folder):
    """Broken once: functions looked at by their type, which is Python's -> the second is kept."""
    swept(Stranger)
    for record in (lambda state: {"largest": jnp.max(state.q)}, strange_record):
        rl.sweep(rl.make("random-walk"), "q-learning", num_seeds=2, **BUDGET, record=record)
    assert not programs_folder.exists()


# --- names -------------------------------------------------------------------------------------------


class Pair(NamedTuple):
    """A class of this package, in the tests below."""

    a: object
    b: object


class Text(str):
    """The same; its value is in no field."""


def test_names_tell_apart_what_differs_in_class_type_or_value(programs_folder, monkeypatch):
    """Broken once: `str` for `repr`, no class, or a list as a tuple -> two share a name."""
    monkeypatch.setattr(Pair, "__module__", "jaxrl_tab.made_up")
    monkeypatch.setitem(sys.modules, "jaxrl_tab.made_up", sys.modules[__name__])
    plain = None, True, 1, 1.0, "1", b"1", "True", 0.0, -0.0, 0.1, 0.1 + 2**-56, 1e999, "inf", "", b"", "a\0b"
    nested = (), [], {}, (1,), [1], {1: None}, ("1",), (1, 2), (1, (2,)), ((1, 2),), "(1,2)", {1: 2}, {"1": 2}
    own = (
        Pair(1, 2),
        Pair(2, 1),
        Budget(num_steps=2),
        Budget(num_steps=2, exact=True),
        Budget(num_episodes=2),
        rl.Sarsa(),
        rl.QLearning(),
        rl.Sarsa(alpha=0.25),
        rl.NStepSarsa(n=2),
        rl.NStepSarsa(n=3),
        rl.Sarsa(alpha=rl.schedules.parse("sample-average")),
        rl.make("windy-gridworld", stochastic=True).shape,
    )
    names = [programs._file(x) for x in (*plain, *nested, *own)]
    assert None not in names and len(set(names)) == len(names)
    assert programs._file(rl.NStepSarsa(n=2)) == programs._file(rl.NStepSarsa(n=2))


def test_weak_types_dtypes_and_shapes_are_part_of_the_name(programs_folder):
    """Broken once: dtypes and shapes alone -> the second shares the name of the first."""
    values = jnp.float32(1), 1.0, jnp.int32(1), jnp.ones(2), jnp.ones((1, 2))
    names = {programs._file(room.signature(rl.QLearning(alpha=x)).name) for x in values[:3]}
    names |= {programs._file(room.signature(x).name) for x in values[3:]}
    assert None not in names and len(names) == 5


def test_what_a_name_does_not_say_in_full_is_not_kept(programs_folder, monkeypatch):
    """Broken once: classes looked at by their module alone -> two that share a name, or a value, are kept."""
    monkeypatch.setattr(Text, "__module__", "jaxrl_tab.made_up")
    monkeypatch.setitem(sys.modules, "jaxrl_tab.made_up", sys.modules[__name__])

    def made():
        class Hidden(NamedTuple):
            a: int

        Hidden.__module__ = "jaxrl_tab.made_up"
        return Hidden(1)

    things = (
        Text("a"),
        made(),
        np.array([object()]),
        np.float32(1),
        len,
        made,
        rl.Sarsa,
        object(),
        {1, 2},
        rl.schedules,
    )
    assert [programs._file(("a", x)) for x in things] == [None] * len(things)


@pytest.mark.parametrize("env", ENVS)
def test_every_method_in_every_environment_has_a_name(programs_folder, env):
    """Broken once: no lists, or no dictionaries, in names -> all fail."""
    env = rl.make(env)
    names = set()
    for method in (ALGORITHMS | PREDICTION).values():
        arguments = room.program_arguments(Budget(num_steps=9), jax.random.key(0), 0, method(), env)
        names.add(programs._file(room.signature(arguments).name))
    assert None not in names and len(names) == len(ALGORITHMS | PREDICTION)


def test_settings_and_sources_are_part_of_the_name(programs_folder, monkeypatch):
    name = programs._file("a")
    assert name == programs._file("a") != programs._file("b")
    monkeypatch.setenv("XLA_FLAGS", "--xla_another=1")
    assert programs._file("a") != name
    monkeypatch.undo()
    monkeypatch.setattr(programs, "_code_and_machine", lambda: b"another version")
    monkeypatch.setattr(programs, "_folder", programs_folder.parent)
    assert programs._file("a").parent == programs_folder and programs._file("a") != name


def test_text_and_bytes_are_names(programs_folder):
    """Such as a program, of a user's own class: versions, settings and machine are part of those as well."""
    with jax.default_matmul_precision("highest"):  # of this thread alone
        other = programs._file("{ lambda ; }")
    names = {programs._file(x) for x in ("{ lambda ; }", b"{ lambda ; }", "{ lambda ; a }", "\ud800")}
    assert None not in names and len(names) == 4 and other not in names
    assert thing("{ lambda ; }") and thing("{ lambda ; }") is None and thing(b"{ lambda ; }")


def test_another_version_and_another_processor_have_other_programs(programs_folder, monkeypatch):
    names = {programs._file("a")}
    installed = provenance.installed()
    others = [("installed", lambda x=x: installed | {x: "9.9"}) for x in ("jax", "jaxlib", "numpy")]
    for name, value in [*others, ("features", lambda: ["avx9"])]:
        with monkeypatch.context() as patched:
            patched.setattr(provenance, name, value)
            programs._code_and_machine.cache_clear()
            names.add(programs._file("a"))
    programs._code_and_machine.cache_clear()
    with jax.default_matmul_precision("highest"):  # of this thread alone
        names.add(programs._file("a"))
    assert len(names) == 6


def test_another_llvm_has_other_programs(programs_folder, monkeypatch):
    """Broken once: its version left out of the name -> machine code of the old one is loaded."""
    swept()
    forget()
    monkeypatch.setattr(machine, "version", lambda: "1.2.3")
    swept()
    assert len(kept_in(programs_folder)) == 2


def test_another_system_has_other_programs_and_no_process_is_started_to_ask_for_it(monkeypatch):
    """Each start does it. Broken once: `platform.platform` -> fails; the release is left out -> fails."""
    monkeypatch.setattr(subprocess, "check_output", lambda *_, **__: pytest.fail("a process"))
    monkeypatch.setattr(platform, "_uname_cache", None)
    ask = programs._code_and_machine.__wrapped__
    here = ask()
    for part in ("system", "release", "version", "machine", "libc_ver"):
        with monkeypatch.context() as patched:
            patched.setattr(platform, part, lambda: "another")
            assert ask() != here, part


def test_where_nobody_asked_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", None)
    assert programs._file("a") is None


# --- what is planted ---------------------------------------------------------------------------------


class Planted:
    """A pickle that does something."""

    def __init__(self, mark):
        self.mark = str(mark)

    def __reduce__(self):
        return Path.touch, (Path(self.mark),)


def test_a_planted_pickle_is_never_loaded(programs_folder, said, tmp_path):
    """Not even one with the right checksum. Broken once: `Program.from_bytes` unpickles -> it is executed."""
    first = swept()
    (file,) = kept_in(programs_folder)
    whole = file.read_bytes()
    plant(file, pickle.dumps(Planted(tmp_path / "executed")))
    forget()
    np.testing.assert_array_equal(swept().q, first.q)
    (line,) = said()
    assert line.startswith(f"{file} is not used, and made again: ")
    assert file.read_bytes() == whole and not (tmp_path / "executed").exists()


def test_nothing_in_the_wing_can_unpickle():
    """Broken once: `import pickle` in one of its modules -> fails."""
    for module in Path(programs.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(module.read_text())):
            names = [x.name for x in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            names.append(getattr(node, "module", None) or "")
            assert not {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"} & set(names), module
            assert not any("serialize_executable" in name for name in names), module


# --- where it is kept --------------------------------------------------------------------------------


def test_a_folder_for_all_has_one_in_it_for_the_user(tmp_path, monkeypatch):
    """JAX_COMPILATION_CACHE_DIR of mode 777."""
    (tmp_path / "all").mkdir()
    (tmp_path / "all").chmod(0o777)
    monkeypatch.setattr(programs, "_folder", None)
    programs.keep(tmp_path / "all")
    assert thing() and thing() is None
    assert stat.S_IMODE((tmp_path / "all" / "programs").stat().st_mode) == 0o700


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


def test_jax_keeps_what_the_user_wants_or_what_takes_long(default, tmp_path, monkeypatch):
    """By default it keeps what takes a second, but a program of ours takes less. Broken once: left so -> fails."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    setting = "jax_persistent_cache_min_compile_time_secs"
    for folder in (None, str(tmp_path / "chosen")):
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update(setting, 1.0)
        assert default() and jax.config.values[setting] == programs.COMPILE_SECONDS
    monkeypatch.setenv(setting.upper(), "3")
    jax.config.update(setting, 3.0)  # as JAX does when it is imported
    assert default() and jax.config.values[setting] == 3
