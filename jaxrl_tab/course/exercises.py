"""The six exercises, as data: what a student writes, and what is looked for in it."""

from pathlib import Path
from typing import NamedTuple

from jaxrl_tab.course.updates import Learner, NStep, QLearning, Traces, WholeReturns

HANDOUTS = Path(__file__).with_name("handouts")


class Exercise(NamedTuple):
    """An exercise.

    Attributes:
        number: 1 to 6.
        title: what people call it.
        source: where the box or the equation is.
        takes: what the constructor can ask for, beside `num_states`, `num_actions` and `rng`.
        learner: what should be learned; None where nothing is.
        mistakes: those of the update that are looked for, before those that more may pass for.
        time_limits: whether some episodes are cut off.
        task: on which environment a right agent shows at last what it can do; its gamma is 1.
        episodes: how many.
        alpha: there.
    """

    number: int
    title: str
    source: str
    takes: tuple[str, ...] = ("gamma", "epsilon")
    learner: type[Learner] | None = None
    mistakes: tuple[str, ...] = ()
    time_limits: bool = True
    task: str = ""
    episodes: int = 0
    alpha: float = 0.5

    @property
    def handout(self) -> Path:
        """The file that a student gets."""
        (path,) = HANDOUTS.glob(f"exercise_{self.number}_*.py")
        return path


def _named(names: str) -> tuple[str, ...]:
    return tuple(names.split())


# Names of mistakes, those first that say most: what several explain is said by the first.
AHEAD = (
    *_named(
        "learns-nothing terminal time-limit swapped-ends no-gamma gamma-on-all never-bootstraps old-state"
    ),
    *_named("skips-terminal skips-time-limit skips-last"),
)
HOW_FAR = _named(
    "alpha-twice no-alpha sample-average alpha-swapped old-not-subtracted whole-target old-lost brackets sign"
)
LOOKS_AT = _named("same-action expected-target uniform-target min-target action-index")
PAIRS = _named("next-pair whole-row all-states terminal-reset swapped-states")
EXERCISES = {
    "epsilon-greedy": Exercise(
        1, "ε-greedy", "book, section 2.2 and the box of section 5.4; Silver, lecture 5"
    ),
    "monte-carlo": Exercise(
        2,
        "Monte Carlo control",
        "book, box of section 5.4",
        learner=WholeReturns,
        mistakes=(
            *_named("learns-nothing every-visit last-visit first-of-state no-gamma gamma-on-all same-return"),
            *_named("discounted-from-start rewards-alone own-reward-missing constant-alpha sum last-return"),
            *_named("counts-all counts-states counts-one-more episodes-kept"),
        ),
        time_limits=False,
        task="blackjack",
        episodes=6000,
    ),
    "sarsa": Exercise(
        3,
        "Sarsa",
        "book, box of section 6.4",
        ("alpha", "gamma", "epsilon"),
        Learner,
        (*AHEAD, *HOW_FAR, "max-target", *LOOKS_AT, *PAIRS, "next-reward", "draws-again"),
        task="windy-gridworld",
        episodes=1000,
        alpha=0.1,
    ),
    "q-learning": Exercise(
        4,
        "Q-learning",
        "book, box of section 6.5",
        ("alpha", "gamma", "epsilon"),
        QLearning,
        (*AHEAD, *HOW_FAR, *LOOKS_AT, *PAIRS, "explores-in-target"),
        task="cliff-walking",
        episodes=300,
    ),
    "n-step-sarsa": Exercise(
        5,
        "n-step Sarsa",
        "book, box of section 7.2",
        ("alpha", "gamma", "epsilon", "n"),
        NStep,
        (
            *_named("learns-nothing terminal time-limit swapped-ends no-gamma never-bootstraps"),
            *_named("n-too-small n-too-large one-step gamma-once gamma-n undiscounted-rewards newest-pair"),
            *_named(
                "flush-oldest flush-one no-flush no-flush-at-time-limit over-the-end over-the-time-limit"
            ),
            *_named(
                "alpha-twice no-alpha sample-average alpha-swapped old-not-subtracted whole-target old-lost sign"
            ),
            *("max-target", *LOOKS_AT, "draws-again"),
        ),
        task="windy-gridworld",
        episodes=1000,
        alpha=0.1,
    ),
    "sarsa-lambda": Exercise(
        6,
        "Sarsa(λ)",
        "book, box of section 12.7; Silver, lecture 5",
        ("alpha", "gamma", "epsilon", "lam"),
        Traces,
        (
            *(*AHEAD, *HOW_FAR),
            *_named("no-traces replacing clears-others traces-kept traces-kept-at-time-limit"),
            *_named("no-lambda no-gamma-in-traces no-fading fades-at-once trace-too-late"),
            *("max-target", *LOOKS_AT, "draws-again"),
        ),
        task="windy-gridworld",
        episodes=1000,
        alpha=0.1,
    ),
}
