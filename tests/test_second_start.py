"""Programs from an earlier process: a second start does not crash, compiles nothing, and has the same bits."""

import os
import subprocess
import sys

import numpy as np
import starts


def test_each_kind_starts_twice_with_the_same_bits(tmp_path):
    """On an empty folder, and once more without any. Broken once: LAPACK not found before -> it crashes."""
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    traced = []
    for start in ("first", "second"):
        command = [sys.executable, starts.__file__, str(tmp_path / f"{start}.npz")]
        done = subprocess.run(command, env=env, capture_output=True, text=True)
        assert done.returncode == 0 and done.stderr == "", done.stderr
        traced.append(int(done.stdout))
    # What records with a function of the user's is traced each time: its code may have changed.
    assert traced == [7, 1]
    kept = list((tmp_path / "cache" / "jaxrl_tab" / "programs").iterdir())
    assert len(kept) == 2 * 6 + 1  # what each needs, and the program; and linear algebra

    without = starts.everything()
    for start in ("first", "second"):
        found = np.load(tmp_path / f"{start}.npz")
        assert set(found) == set(without) and len(found) > 40
        for name, expected in without.items():
            assert found[name].tobytes() == expected.tobytes(), name
