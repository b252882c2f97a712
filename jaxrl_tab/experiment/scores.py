"""The scores of an experiment in one small file, by which other methods are ranked without computing it again.

A folder of results is large. What a ranking needs of it is a number for each run of a chosen setting on its fresh
seeds, and what these runs were. Nothing in such a file is taken for granted when it is read.
"""

import contextlib
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxrl_tab.core.errors import InputError, one_line
from jaxrl_tab.experiment import disk
from jaxrl_tab.experiment.resolve import environments
from jaxrl_tab.experiment.spec import environment_of

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.core.types import Environment

SUFFIX = ".npz"
FORMAT = "scores of jaxrl_tab 1"
MOST_BYTES = 2**28
KEPT = (  # the attributes of a dataset without which its scores mean nothing
    "environment",
    "environment_parameters",
    "algorithm",
    "learns",
    "fixed",
    "num_steps",
    "num_episodes",
    "root_seed",
    "fresh_seeds",
    "optimal_value",
)
NUMBERS = ("num_steps", "num_episodes", "root_seed", "fresh_seeds", "optimal_value")


def save(
    file: Path,
    fresh: "Mapping[str, xr.Dataset]",
    experiment: Mapping[str, Any],
    session: Mapping[str, Any] | None,
) -> None:
    """Writes the scores of chosen settings on their fresh seeds.

    Args:
        file: a new file, "....npz".
        fresh: as those of an `Outcome`, by "ENVIRONMENT/METHOD"; all on the same seeds.
        experiment: the data of the experiment.
        session: the record of the session that computed them.
    """
    from jaxrl_tab.stats.measures import diverged_runs, score

    names, seeds = list(fresh), next(iter(fresh.values())).seed.values
    about = {
        "format": FORMAT,
        "experiment": dict(experiment),
        "session": None if session is None else dict(session),
        "parts": {
            name: {key: ds.attrs[key] for key in KEPT if key in ds.attrs} for name, ds in fresh.items()
        },
    }
    lost = [np.broadcast_to(diverged_runs(fresh[name]).values, seeds.shape) for name in names]
    arrays = {"score": np.stack([score(fresh[name]).values for name in names]), "diverged": np.stack(lost)}
    arrays |= {"seed": seeds, "about": np.frombuffer(json.dumps(about).encode(), np.uint8)}
    with io.BytesIO() as data:
        np.savez_compressed(data, **arrays)  # pyright: ignore[reportArgumentType]
        disk.write(file, data.getvalue())


def load(file: Path) -> "tuple[dict[str, xr.Dataset], dict[str, Any], dict[str, Any] | None]":
    """What `save` wrote: the fresh runs, the data of the experiment, and the record of the session.

    Of each run there is one row, with one episode that earned the score.

    Raises:
        InputError: the file cannot be read, or what is in it is not what `save` writes.
    """
    name = one_line(str(file))
    try:
        if file.stat().st_size > MOST_BYTES:
            raise ValueError
        with zipfile.ZipFile(file) as members:
            if sum(member.file_size for member in members.infolist()) > MOST_BYTES:
                raise ValueError
        with np.load(file, allow_pickle=False) as arrays:
            score, diverged, seed = (arrays[key] for key in ("score", "diverged", "seed"))
            about = json.loads(arrays["about"].tobytes())
    except OSError as error:
        raise InputError(f"{name} cannot be read: {error.strerror or 'it is damaged'}") from None
    except Exception:  # there is no end to what NumPy and zipfile raise of damaged files
        raise InputError(f"{name} is no file of scores, or is damaged") from None
    if wrong := _wrong(score, diverged, seed, about):
        raise InputError(f"{name} is no file of scores as this version writes it: {wrong}")
    found = {}
    for i, (part, attrs) in enumerate(about["parts"].items()):
        found[part] = _dataset(score[i], diverged[i], seed, attrs)
    return found, about["experiment"], about["session"]


def _wrong(score: np.ndarray, diverged: np.ndarray, seed: np.ndarray, about: Any) -> str:
    """What is not as `save` writes it; empty where all is."""
    parts = about.get("parts") if isinstance(about, dict) and about.get("format") == FORMAT else None
    if not isinstance(parts, dict) or not parts:
        return "it does not say what is in it"
    if not isinstance(about.get("experiment"), dict) or not isinstance(about.get("session"), dict | None):
        return "it does not say what was computed"
    shape = (len(parts), len(seed)) if seed.ndim == 1 else None
    kinds = score.dtype.kind, diverged.dtype.kind, seed.dtype.kind
    if score.shape != shape or diverged.shape != shape or kinds != ("f", "b", "i"):
        return "there is not a score of each seed in each part"
    if len(np.unique(seed)) < len(seed):
        return "a seed is there twice"
    for name, attrs in parts.items():
        if name.count("/") != 1 or not name.isprintable() or not isinstance(attrs, dict):
            return f"{one_line(name)} is not the name of a part"
        if not {"environment", "fixed", "root_seed"} <= attrs.keys() <= set(KEPT):
            return f"{one_line(name)} does not say what its runs were"
        for key, value in attrs.items():
            if not isinstance(value, int | float if key in NUMBERS else str):
                return f"{key} of {one_line(name)} is no {'number' if key in NUMBERS else 'text'}"
        if "num_steps" not in attrs and "num_episodes" not in attrs:
            return f"{one_line(name)} does not say how long its runs were"
        if not all(_is_table(attrs.get(key, "{}")) for key in ("fixed", "environment_parameters")):
            return f"the settings of {one_line(name)} are damaged"
    return ""


def _is_table(text: str) -> bool:
    try:
        return isinstance(json.loads(text), dict)
    except ValueError:
        return False


def _dataset(
    score: np.ndarray, diverged: np.ndarray, seed: np.ndarray, attrs: Mapping[str, Any]
) -> "xr.Dataset":
    import xarray as xr

    length = attrs.get("num_steps", attrs.get("num_episodes"))
    steps = np.full((len(seed), 1), length)
    variables = {
        "steps": (("seed", "row"), steps),
        "episodes": (("seed", "row"), np.ones_like(steps)),
        "returns": (("seed", "row"), score[:, None].astype(float)),
        "diverged": ("seed", diverged),
    }
    return xr.Dataset(variables, {"seed": seed, "row": [0]}, {**attrs, "log_every": length})


def known_environments(experiment: Mapping[str, Any] | None) -> "dict[str, Environment]":
    """The environments of an experiment by their labels; of ours alone, for nobody's code is run to look at results."""
    from jaxrl_tab.envs import ENVS, PREFIX

    found = {}
    for table in (experiment or {}).get("environment", []):
        name = table.get("name")
        own = name.removeprefix(f"{PREFIX}:").rpartition(":")[2] if isinstance(name, str) else None
        if own not in ENVS or "sha256" in table:
            continue
        with contextlib.suppress(InputError):  # of another version, or damaged
            references = {}
            (one,) = environments([table], None, references)
            found[one["label"]] = environment_of(one, references)[0]
    return found
