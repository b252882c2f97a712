"""Where methods lose what they earn less than the best policy, in numbers and in words."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from jaxrl_tab.core.declared import of_environment
from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.types import Environment
from jaxrl_tab.exact import planning
from jaxrl_tab.exact.losses import Losses
from jaxrl_tab.show.states import state_names
from jaxrl_tab.show.words import counted, decimals_for, label_of, number
from jaxrl_tab.stats.intervals import mean_interval

MOST_OF_IT = 0.75  # the part of the loss that a sentence puts into as few states as it takes
FEW, SOME = 5, 3  # states that are all named in a sentence; and that are, of more
LISTED = 10  # states in a table
NOTHING = 1e-9  # of the size of v*: what is less is rounding


class Place(NamedTuple):
    """What is lost in a state.

    Attributes:
        state, name: its number and its name.
        visits: how often the policies are there, mean.
        lost: the mean of what they lose there; share: as a part of all that they lose.
        actions: the actions by which it is lost, by their names, the worst first, with the share of each.
    """

    state: int
    name: str
    visits: float
    lost: float
    share: float
    actions: dict[str, float]


@dataclass(frozen=True)
class Explained:
    """Where a method loses, at its best setting, after all that it has learned.

    Attributes:
        environment, method: their names.
        env: the environment.
        setting: the hyperparameters that were swept, at their best values.
        optimum: v* from the start.
        seeds: how many runs there are in the numbers; diverged ones are left out.
        acting: what the policies lose by which the runs act in the end, exploring as they do; None where the method
            does not say by what probabilities it acts.
        greedy: what the policies lose that are greedy to what the runs have learned.
        least: what every policy loses at the least that explores as the method does; NaN where that is not known.
    """

    environment: str
    method: str
    env: Environment
    setting: dict[str, Any]
    optimum: float
    seeds: int
    acting: Losses | None
    greedy: Losses
    least: float

    @property
    def name(self) -> str:
        """The method with its setting, as people read it."""
        return label_of(self.method, self.setting)

    @property
    def main(self) -> Losses:
        """What is told of first: of the policies that act, where they are known."""
        return self.greedy if self.acting is None else self.acting

    def loses(self, losses: Losses) -> bool:
        """Whether more than rounding is lost, finitely."""
        return bool(losses.by_action.sum() > NOTHING * max(1.0, abs(self.optimum)))

    def places(self, losses: Losses) -> list[Place]:
        """The states in which anything is lost, the worst first."""
        by_state, names = losses.by_state, of_environment(self.env).action_names
        if not self.loses(losses):
            return []
        name_of, total = state_names(self.env), by_state.sum()
        order = np.argsort(-by_state, kind="stable")
        return [
            Place(
                int(s),
                name_of(int(s)),
                float(losses.visits[s]),
                float(by_state[s]),
                float(by_state[s] / total),
                {
                    names[a]: float(losses.by_action[s, a] / by_state[s])
                    for a in np.argsort(-losses.by_action[s], kind="stable")
                    if losses.by_action[s, a] > 0
                },
            )
            for s in order[by_state[order] > 0]
        ]

    @property
    def sentences(self) -> list[str]:
        """The findings, in whole sentences."""
        found = []
        if self.acting is not None:
            found += [*self._of_acting(self.acting)]
        return [*found, *self._of_greedy(self.greedy)]

    def _of_acting(self, losses: Losses) -> Iterator[str]:
        over = f"mean over {counted(self.seeds - losses.endless, 'seeds')}"
        if losses.endless:
            yield self._of_endless("The policies that act", losses)
        if losses.endless == self.seeds:
            return
        if not self.loses(losses):
            yield f"As it acts in the end it loses nothing: its policy is optimal ({over})."
            return
        mean, low, high = _interval(losses.lost)
        digits = decimals_for(np.array([(high - low) / 2, mean]), 2)
        interval = "" if np.isnan(low) else f", 95% interval {number(low, digits)} to {number(high, digits)}"
        middle = number(float(np.median(losses.lost)), digits)
        yield (
            f"As it acts in the end it earns {number(mean, digits)} less than the best policy, whose value from the "
            f"start is {number(self.optimum)} ({over}{interval}; median {middle})."
        )
        ended = np.isfinite(losses.lost)
        exploring = losses.exploring[ended].sum() / losses.lost[ended].sum()
        least = (
            ""
            if np.isnan(self.least)
            else f"; a policy that explores as much loses {number(self.least)} at the least"
        )
        yield (
            f"{_percent(exploring)} of that is lost by exploring, {_percent(1 - exploring)} by the actions that it "
            f"holds for the best{least}."
        )
        yield self._of_places(losses)

    def _of_greedy(self, losses: Losses) -> Iterator[str]:
        without = "" if self.acting is None else "Without exploring, "
        if losses.endless:
            yield _sentence(self._of_endless(f"{without}greedy policies", losses))
            without = ""
        if losses.endless == self.seeds:
            return
        which = "the other" if losses.endless else "all"
        who = f"{without}the greedy policies of {which} {counted(self.seeds - losses.endless, 'seeds')}"
        if not self.loses(losses):
            yield _sentence(f"{who} lose nothing: they are optimal.")
            return
        lost = losses.lost[np.isfinite(losses.lost)].mean()
        yield _sentence(f"{who} lose {number(float(lost), decimals_for(np.array([lost]), 3))} on average.")
        if self.acting is None or not self.loses(self.acting):
            yield self._of_places(losses)

    def _of_endless(self, who: str, losses: Losses) -> str:
        often = np.argsort(-losses.caught, kind="stable")[:SOME]
        name_of = state_names(self.env)
        where = [f"{name_of(int(s))} ({losses.caught[s]})" for s in often if losses.caught[s]]
        return (
            f"{who} of {losses.endless} of {counted(self.seeds, 'seeds')} may go round for ever, and lose without "
            f"bound; the states in which the most are caught: {', '.join(where)}."
        )

    def _of_places(self, losses: Losses) -> str:
        places = self.places(losses)
        shares = np.cumsum([place.share for place in places])
        needed = min(int(np.searchsorted(shares, MOST_OF_IT - 1e-9)) + 1, len(places))
        model = planning.exact_model(self.env)
        states = int((planning.reachable(model) & ~planning.terminal_states(model)).sum())
        named = places[: needed if needed <= FEW else SOME]
        names = [f"{place.name} ({_percent(place.share)})" for place in named]
        part = "All of it is" if needed == len(places) else f"{_percent(float(shares[needed - 1]))} of it is"
        these = ":" if needed <= FEW else ", most in"
        return f"{part} lost in {needed} of {counted(states, 'states')}{these} {_listed(names)}."

    def to_dict(self) -> dict[str, Any]:
        """The same as JSON has it."""
        kinds = {"acting": self.acting, "greedy": self.greedy}
        return {
            "environment": self.environment,
            "method": self.method,
            "setting": {name: getattr(x, "item", lambda x=x: x)() for name, x in self.setting.items()},
            "optimum": self.optimum,
            "seeds": self.seeds,
            "least": _or_none(self.least),
            "sentences": self.sentences,
            **{kind: None if losses is None else self._data(losses) for kind, losses in kinds.items()},
        }

    def _data(self, losses: Losses) -> dict[str, Any]:
        mean, low, high = map(_or_none, _interval(losses.lost))
        ended = np.isfinite(losses.lost)
        return {
            "lost": mean,
            "low": low,
            "high": high,
            "exploring": float(losses.exploring[ended].mean()) if ended.any() else None,
            "endless": losses.endless,
            "states": [place._asdict() for place in self.places(losses)],
        }

    def row(self) -> list[str]:
        """The row of `HEAD`."""
        cells = [self.environment, self.name]
        losses = self.acting
        if losses is None or losses.endless == self.seeds:
            cells += ["–"] * 3
        else:
            mean, low, high = _interval(losses.lost)
            digits = decimals_for(np.array([(high - low) / 2, mean]), 2)
            ended = np.isfinite(losses.lost)
            exploring = float(losses.exploring[ended].mean())
            between = "" if np.isnan(low) else f" ({number(low, digits)} to {number(high, digits)})"
            cells += [
                number(mean, digits) + between,
                number(exploring, digits),
                number(mean - exploring, digits),
            ]
        cells.append(number(self.least))
        lost = self.greedy.lost[np.isfinite(self.greedy.lost)]
        cells.append(
            number(float(lost.mean()), decimals_for(np.array([lost.mean()]), 3)) if len(lost) else "–"
        )
        return [*cells, f"{self.greedy.endless} of {self.seeds}"]


HEAD = (
    "environment",
    "method",
    "lost as it acts (95% interval)",
    "by exploring",
    "by greedy actions",
    "at the least, exploring so",
    "lost by greedy policies",
    "greedy ones that never end",
)
PLACES = ("state", "visits", "lost", "share", "by")


def places_rows(places: list[Place]) -> list[list[str]]:
    """The rows of `PLACES`, of the worst states."""
    shown = places[:LISTED]
    digits = decimals_for(np.array([place.lost for place in shown]), 2)
    by = lambda place: ", ".join(
        f"{name} {_percent(share)}" for name, share in [*place.actions.items()][:SOME]
    )
    return [
        [place.name, number(place.visits, 3), number(place.lost, digits), _percent(place.share), by(place)]
        for place in shown
    ]


class Explanation(Mapping[str, Explained]):
    """Where the methods of a sweep or an experiment lose, by "ENVIRONMENT/METHOD".

    Attributes:
        left_out: why others are not in it: a sentence for each.
    """

    def __init__(self, methods: Mapping[str, Explained], left_out: list[str]) -> None:
        self._methods, self.left_out = dict(methods), left_out

    def __getitem__(self, name: str) -> Explained:
        return self._methods[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._methods)

    def __len__(self) -> int:
        return len(self._methods)

    def __repr__(self) -> str:
        return f"<Explanation: {', '.join(self)}>"

    def __str__(self) -> str:
        parts = [f"{one.name} in {one.environment}: {' '.join(one.sentences)}" for one in self.values()]
        return "\n".join([*parts, *self.left_out])

    def _repr_html_(self) -> str:
        parts = [table("Where what is lost is lost", HEAD, [one.row() for one in self.values()])]
        for one in self.values():
            parts.append(
                table(" ".join([f"{one.name}.", *one.sentences]), PLACES, places_rows(one.places(one.main)))
            )
        return "\n".join(parts)

    def save(self, folder: Path | str) -> list[Path]:
        """Writes a heat map for each method into `folder`, "METHOD.png", which is made if need be; see `loss_maps`."""
        from jaxrl_tab.show import loss_maps  # and with it Matplotlib

        return loss_maps.save(self, Path(folder))


def _interval(x: np.ndarray) -> tuple[float, float, float]:
    """The mean of what is finite, and its 95% interval, NaN where there are too few."""
    x = x[np.isfinite(x)]
    if not len(x):
        return np.nan, np.nan, np.nan
    mean, low, high, _ = mean_interval(xr.DataArray(x, dims="seed"))
    return (
        float(mean),
        max(float(low), 0.0) if low == low else np.nan,
        float(high),
    )  # nobody earns more than the best


def _or_none(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


def _percent(share: float) -> str:
    """A share in words; neither all nor nothing by rounding."""
    if 0 < share < 0.005:
        return "less than 1%"
    if 0.995 <= share < 1 - 1e-9:
        return "more than 99%"
    return f"{100 * share:.0f}%"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
