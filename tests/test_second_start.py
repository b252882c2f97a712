"""A second start: what JAX compiled comes from its cache, and the bits are the same."""

import os
import subprocess
import sys

import numpy as np
import pytest
import starts


@pytest.mark.slow
def test_each_kind_starts_twice_with_the_same_bits(tmp_path):
    """On an empty folder, and once more without any. Broken once: JAX not told of the folder -> nothing comes from it.

    The user's threshold of JAX is kept: here all that is compiled is.
    """
    env = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    folder = tmp_path / "cache" / "jaxrl_tab"
    of_jax, came_from_it = [], []
    for start in ("first", "second"):
        command = [sys.executable, starts.__file__, str(tmp_path / f"{start}.npz")]
        done = subprocess.run(command, env=env, capture_output=True, text=True)
        assert done.returncode == 0 and done.stderr == "", done.stderr
        traced, hits = map(int, done.stdout.split())
        # In the second start only what records with a function of the user's, which may have changed.
        assert traced == (7 if start == "first" else 1)
        of_jax.append({file.name for file in folder.glob("*-cache")})
        came_from_it.append(hits)
    # What was needed only to lower a run is not compiled again; and what is compiled comes from the cache.
    assert of_jax[0] == of_jax[1] and came_from_it[1] >= 7
    # The kernel of each, and the key.
    assert len(list((folder / "programs").iterdir())) == 6 + 1

    without = starts.everything()
    for start in ("first", "second"):
        found = np.load(tmp_path / f"{start}.npz")
        assert set(found) == set(without) and len(found) > 30
        for name, expected in without.items():
            assert found[name].tobytes() == expected.tobytes(), name
