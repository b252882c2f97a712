"""Names, numbers and settings as people read them."""

import dataclasses
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxrl_tab.core.types import Environment
from jaxrl_tab.envs import ENVS
from jaxrl_tab.methods import METHODS

if TYPE_CHECKING:  # which takes its time to import
    from jaxrl_tab.stats.along import Datasets

LONGEST = 60  # characters of a name
DOES_NOT_END = (
    "The task does not end. The return is that of an episode which its time limit ended, or of the last tenth, as if "
    "cut off; what a step earns does not depend on that."
)


def six_digits(x: float) -> str:
    """`x` with six significant digits; a rounding error around 0 is shown as 0."""
    # Adding 0 turns -0.0 into 0.0.
    return f"{round(x, 9) + 0:.6g}"


def number(x: float, decimals: int | None = None) -> str:
    """`x` with so many decimals, or with six digits; a dash where there is none."""
    if np.isnan(x):
        return "–"
    text = f"{round(x, 9) + 0:.6g}" if decimals is None else f"{round(x, decimals) + 0:,.{decimals}f}"
    return text.replace("-", "−").replace(",", "\xa0").replace("inf", "∞")


def worth(x: float, write: Callable[[float], str] = number) -> str:
    """What a policy is worth; a dash where it goes round for ever, at a cost without end."""
    return "–" if np.isneginf(x) else write(x)


def steps_in_words(x: float) -> str:
    """Steps until something happens: infinitely many where it did not happen yet."""
    return "none yet" if np.isinf(x) else f"{x:.1f}" if x < 100 else f"{x:.0f}"


def listed(names: Sequence[str], what: str) -> str:
    """The names in words; of more than three only how many there are: "4 methods"."""
    if len(names) > 3:
        return f"{len(names)} {what}"
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def counted(n: int, what: str) -> str:
    """A number with what it counts, which is given in the plural: "1 step", "8 000 steps"."""
    return f"{n:,} {what if n != 1 else what.removesuffix('s')}".replace(",", " ")


def counts_in_words(counts: Iterable[int]) -> str:
    return " or ".join(str(n) for n in sorted(set(counts)))


def some(count: int, most: int) -> list[int]:
    """At most so many of the numbers from 0 on that are below `count`, the last among them: the later, the fewer."""
    if count <= most:
        return list(range(count))
    return sorted({round(x) - 1 for x in np.geomspace(1, count, most)})


def text_of(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def shortened(name: str) -> str:
    """A name of at most `LONGEST` characters, with what may tell it from others: its beginning and its end."""
    half = LONGEST // 2
    return name if len(name) <= LONGEST else f"{name[: half - 1]}…{name[-half:]}"


def label_of(method: str, setting: Mapping[str, Any]) -> str:
    return ", ".join([shortened(title_of(method)), *in_words(setting)])


def in_words(setting: Mapping[str, Any]) -> list[str]:
    """Each of the hyperparameters with its value as people write it, "α = 0.5"; but for texts that are empty."""
    return [
        f"{symbol(name)} = {written(x)}" for name, x in setting.items() if not (isinstance(x, str) and not x)
    ]


def written(x: Any) -> str:
    """The value of a hyperparameter as people write it."""
    if isinstance(x, bool):
        return "on" if x else "off"
    if isinstance(x, int | float):
        return significant(x, 6 if abs(x) >= 1 else 4)  # what is drawn at random has many digits
    return str(x)


def significant(x: float, digits: int = 6) -> str:
    return f"{round(x, 9) + 0.0:.{digits}g}".replace("-", "−")


def seeds_in_words(datasets: "Datasets") -> str:
    """How many seeds there are: "20 seeds"."""
    count = " or ".join(str(n) for n in sorted({ds.sizes["seed"] for ds in datasets.values()}))
    return f"{count} seed{'s' * (count != '1')}"


def unusual(env: Environment) -> list[str]:
    """The parameters of the environment that are not as they are by default, each with its value."""
    return [
        f"{field.name} = {getattr(env, field.name)}"
        for field in dataclasses.fields(env)  # pyright: ignore[reportArgumentType]
        if isinstance(field.default, (str, int, float))
        and np.ndim(getattr(env, field.name)) == 0
        and getattr(env, field.name) != field.default
    ]


# As people write the names in which not only the first letter is large.
TITLES = {  # where `_written` says it otherwise than people do
    "q-sigma": "Q(σ)",
    "retrace": "Retrace(λ)",
    "q-pi-lambda": "Q^π(λ)",
    "sarsa-lambda-forward": "Forward-view Sarsa(λ)",
    "dyna-q": "Dyna-Q",
    "dyna-q-plus": "Dyna-Q+",
    "r-max": "R-max",
    "q-learning-target": "Q-learning of a target policy",
    "reinforce": "REINFORCE",
    "reinforce-baseline": "REINFORCE with baseline",
    "psrl": "PSRL",
    "deep-q-network": "Deep Q-network",
    "gtd2": "GTD2",
    "tdc": "TDC",
    "lstd": "LSTD",
    "lspi": "LSPI",
    "tsitsiklis-van-roy": "Tsitsiklis and Van Roy",
    "ucbvi": "UCBVI",
    "td": "TD(0)",
    "offline-lambda-return": "Off-line λ-return",
    "off-policy-td": "Off-policy TD(0)",
    "jacks-car-rental": "Jack's car rental",
    "gamblers-problem": "Gambler's problem",
}
# Parts of names, in lower case and with spaces, and how they are written.
NAMES = {
    "q learning": "Q-learning",
    "r learning": "R-learning",
    "expected sarsa": "Expected Sarsa",
    "sarsa": "Sarsa",
    "monte carlo": "Monte Carlo",
    "td": "TD",
    "ucb": "UCB",
    "n step": "n-step",
    "off policy": "off-policy",
    "actor critic": "actor-critic",
    "semi gradient": "semi-gradient",
    "k armed": "k-armed",
}
SYMBOLS = {
    "alpha": "α",
    "epsilon": "ε",
    "gamma": "γ",
    "lam": "λ",
    "sigma": "σ",
    "alpha_v": "α_v",
    "lam_v": "λ_v",
    "theta0": "θ0",
    "theta": "θ",
    "kappa": "κ",
}


def title_of(name: str) -> str:
    """The name of an environment or a method as people write it; a name that a user gave stays as it is."""
    plain, *parameters = name.split(",")  # "random-walk,states=5" of an experiment
    if plain in ENVS or plain in METHODS:
        plain = TITLES.get(plain) or _written(plain)
    return ",".join([plain, *parameters])


def _written(name: str) -> str:
    """The name of what is registered, "double-q-learning", as people write it: "Double Q-learning"."""
    title = re.sub(" lambda$", "(λ)", name.replace("-", " "))
    for part, written in NAMES.items():
        title = re.sub(rf"\b{part}\b", written, title)
    title = re.sub(r"^q\b", "Q", title)
    return title if title.startswith(("n-step", "k-armed")) else title[0].upper() + title[1:]


def symbol(name: str) -> str:
    """The name of a hyperparameter as people write it: "α"."""
    return SYMBOLS.get(name, name)


def edge_warning(parameter: str, method: str, end: str) -> str:
    """What to know where the best value is the "largest" or the "smallest" tried; see `stats.at_edge`."""
    best = f"The best {symbol(parameter)} of {title_of(method)}"
    return f"{best} is the {end} that was tried; a better one may lie beyond."


def deadly_triads(methods: Mapping[str, Any]) -> Iterator[str]:
    """What to know of methods of which runs diverged, and which had every reason to: from the dataset of each."""
    for name, ds in methods.items():
        if ds.attrs.get("deadly_triad") and bool(ds.diverged.any()):
            yield (
                f"{title_of(name)} approximates, bootstraps, and learns about another policy than the one that acts: "
                "the deadly triad, with which no step size is safe (book, section 11.3)."
            )


def decimals_for(x: np.ndarray, digits: int) -> int:
    """How many decimals show so many significant digits of the smallest of `x` above 0, from 2 to 5."""
    least = x[np.isfinite(x) & (x > 0)].min(initial=1)
    return int(np.clip(digits - 1 - np.floor(np.log10(least)), 2, 5))


def cell(value: Any, write: Any) -> str:
    """`write(value)`, or a dash where there is no value."""
    return "–" if value != value else write(value)  # NaN is not equal to itself


def short_number(x: float) -> str:
    """`x` in a narrow cell: three significant digits of four decimals, or all that are before the point."""
    return f"{x:.0f}" if abs(x) >= 100 else f"{round(x, 4) + 0:.3g}"
