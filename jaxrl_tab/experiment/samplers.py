"""Who proposes the settings of a search: chance, or Optuna, which learns from those before.

Optuna is asked for all settings of a round at once, so that one program runs all of them, and is told how good they
were before the next round. What it proposes depends on that and on the root seed alone: its random numbers begin anew
in each round. So a search that was interrupted asks again, and is told the same again; nothing that is needed is in
Optuna's storage, which is there for other tools to look at.
"""

import contextlib
import hashlib
import importlib.util
import json
from collections.abc import Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine.axes import DIGITS, Choice, Integers, LogUniform, Random
from jaxrl_tab.experiment.resolve import axis
from jaxrl_tab.experiment.search import Halving

MISSING = "optuna is not installed: pip install 'jaxrl-tab[optuna]', or take --sampler random"


class Told(NamedTuple):
    """How good a setting was that was proposed.

    Attributes:
        scores: at the end of each rung that it reached, by the length of its runs there; higher is better; None where
            all of its runs diverged.
        is_finished: whether it reached the last rung.
    """

    scores: Mapping[int, float | None]
    is_finished: bool


def check_installed() -> None:
    """Raises InputError where Optuna is not there."""
    if importlib.util.find_spec("optuna") is None:
        raise InputError(MISSING)


def versions(halving: Halving) -> dict[str, str]:
    """The version of what proposes the settings, on which they depend; nothing where it is chance."""
    if not halving.is_optuna:
        return {}
    check_installed()
    return {"optuna": metadata.version("optuna")}


class Optuna:
    """Proposes settings of a method by Optuna's TPE (Bergstra et al. 2011), through ask and tell.

    Attributes:
        study: Optuna's study of the method.
    """

    def __init__(self, label: str, ranges: Mapping[str, Any], seed: int, file: Path | None):
        """Begins a study.

        Args:
            label: of the method.
            ranges: what is searched, as `Search.ranges` has it.
            seed: the root seed.
            file: in which Optuna keeps its studies, as a journal; None: in memory.
        """
        check_installed()
        self._label, self._seed, self._round = label, seed, 0
        self._ranges = {key: axis(key, written) for key, written in ranges.items()}
        with _quiet() as optuna:
            storage = None
            if file is not None:
                from optuna.storages import JournalStorage
                from optuna.storages.journal import JournalFileBackend

                storage = JournalStorage(JournalFileBackend(str(file)))
            self.study = optuna.create_study(storage=storage, study_name=label, direction="maximize")
        self._asked: list[Any] = []

    def ask(self, count: int) -> list[dict[str, Any]]:
        """So many settings: each a value of everything that is searched."""
        with _quiet() as optuna:
            text = json.dumps([self._seed, self._label, self._round])
            seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")
            # Of settings that are being tried it thinks that they are bad, so that it does not propose them twice.
            self.study.sampler = optuna.samplers.TPESampler(seed=seed, constant_liar=True)
            ranges = {key: _distribution(optuna, x) for key, x in self._ranges.items()}
            self._asked = [self.study.ask(ranges) for _ in range(count)]
        self._round += 1
        return [{key: _value(x, one.params[key]) for key, x in self._ranges.items()} for one in self._asked]

    def tell(self, told: Sequence[Told]) -> None:
        """How good those were that were asked for last. Those that did not reach the last rung count as pruned."""
        with _quiet() as optuna:
            for trial, one in zip(self._asked, told, strict=True):
                for length, score in one.scores.items():
                    if score is not None:
                        trial.report(score, step=length)
                last = list(one.scores.values())[-1]
                if one.is_finished and last is not None:
                    self.study.tell(trial, last)
                else:
                    self.study.tell(trial, state=optuna.trial.TrialState.PRUNED)


def _distribution(optuna: Any, range_: Any) -> Any:
    """A range as Optuna knows it; of a list it chooses a place."""
    if isinstance(range_, Integers):
        return optuna.distributions.IntDistribution(range_.low, range_.high)
    if isinstance(range_, Random) and not isinstance(range_, Choice):
        one: Any = range_
        return optuna.distributions.FloatDistribution(one.low, one.high, log=isinstance(one, LogUniform))
    return optuna.distributions.CategoricalDistribution(range(len(_choices(range_))))


def _value(range_: Any, proposed: Any) -> Any:
    if isinstance(range_, Random) and not isinstance(range_, Choice):
        return proposed if isinstance(range_, Integers) else float(f"{proposed:.{DIGITS}g}")
    return _choices(range_)[proposed]


def _choices(range_: Any) -> Sequence[Any]:
    return range_.values if isinstance(range_, Choice) else range_


@contextlib.contextmanager
def _quiet() -> Iterator[Any]:
    """Optuna, which says nothing within the block."""
    import optuna

    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        yield optuna
    finally:
        optuna.logging.set_verbosity(before)
