"""`jaxrl-tab search`: good settings of each method, found by successive halving."""

import shlex
from collections.abc import Mapping
from pathlib import Path

from jaxrl_tab.cli.common import ENVIRONMENT, HYPERPARAMETERS, STEPS, find, groups_in, prepare, start_jax
from jaxrl_tab.cli.options import Typed
from jaxrl_tab.cli.running import (
    Where,
    is_typed_as_file,
    length_typed,
    methods_typed,
    say_where_of,
    watched,
)
from jaxrl_tab.cli.screen import busy
from jaxrl_tab.cli.streams import PROG, print_json
from jaxrl_tab.cli.typed import Classes, parse, several_of, word
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.engine.axes import LogUniform, Random
from jaxrl_tab.engine.backend import Backend
from jaxrl_tab.experiment import runner, search

DRAWS = 27  # settings of each method, where nobody says how many
SEEDS = 20  # on which settings are compared; what is found runs on 100 fresh ones
RANGES = HYPERPARAMETERS._replace(
    help="Of the methods; several values make a grid. 0.01:0.3 is a range of which settings are drawn, 0.01:1:log one "
    "in which each power of ten is as likely as the next, 1:8 one of whole numbers.",
    defaults={"alpha": (LogUniform(0.01, 1.0),)},
    ranges=True,
)


@checked_dataclass
class Search(Where):
    """Good settings of each method, found without running all of them to the end: by successive halving.

    Of all settings, which are drawn from ranges, or a grid, one in three goes on to three times as many seeds, and of
    these one in three to all seeds; or to longer runs, from where they are. The best is run again on fresh seeds,
    which had no part in the choice: the table is of them. With --out, leaves a folder as `sweep` does, and search.csv:
    what was tried, and how good it was. Where that is interrupted, `jaxrl-tab resume` goes on.

    Examples:
      jaxrl-tab search windy-gridworld sarsa q-learning --alpha 0.05:1:log --epsilon 0.01:0.3 --draws 27 --out runs/best
      jaxrl-tab search windy-gridworld sarsa --alpha 0.1 0.3 0.5 0.7 0.9 --epsilon 0.01 0.03 0.1
      jaxrl-tab search cliff-walking n-step-sarsa --alpha 0.05:1:log --n 1:8 --budget 5e6
      jaxrl-tab search cliff-walking sarsa --alpha 0.05:1:log --draws 40 --grow steps
      jaxrl-tab search windy-gridworld sarsa --epsilon 0.01:0.3 --draws 36 --sampler optuna
      jaxrl-tab search experiment.toml --out runs/best

    Attributes:
        env: Name of the environment, see `jaxrl-tab list`; or a search in a file FILE.toml: as of a sweep, with a table
            [search].
        methods: Names of one or more methods; see `jaxrl-tab list`. An option goes to all that have it.
        draws: How many settings of each method are drawn from the ranges. (default: 27)
        budget: Instead: as many as so many steps in all (episodes, with --episodes) allow, for each method.
        one_in: Of the settings of a rung one in so many goes on, to so many times the budget.
        rungs: How many rungs there are; in the last one runs have full length, on all seeds.
        grow: What is more from rung to rung: seeds, where all runs have full length, or steps.
        sampler: What proposes settings: random, or optuna (pip install 'jaxrl-tab[optuna]'), which learns from those
            before.
        rounds: In how many rounds Optuna proposes them. (default: 4)
        seeds: On how many seeds settings are compared.
        fresh_seeds: On how many fresh seeds what was found is run.
        steps: How many steps each run takes in the end.
        episodes: How many episodes each run finishes in the end, instead of --steps.
        log_every: How many steps, or episodes, are summed up in one row of the log: 100 steps, or 1 episode, by
            default.
        seed: Which sequence of seeds, and of draws.
        exact: Also record exact values, of what was found, as `sweep` does.
        backend: What compiles it: lanes, which is for CPUs and fast, or xla. By default lanes, where it can.
        out: New folder for the data and the pictures.
        dry_run: Show how many settings run for how long, and stop.
    """

    env: str = word("ENV|FILE")
    methods: tuple[str, ...] = word("METHOD ...", many=True)
    draws: int | None = field(default=None, at_least=1)
    budget: int | None = field(default=None, at_least=1)
    one_in: int = field(default=3, at_least=2)
    rungs: int = field(default=3, at_least=1)
    grow: search.Growing = field(default="seeds", static=True)
    sampler: search.Sampling = field(default="random", static=True)
    rounds: int | None = field(default=None, at_least=1)
    seeds: int = field(default=SEEDS, at_least=1)
    fresh_seeds: int = field(default=100, at_least=2)
    steps: int = field(default=STEPS, at_least=1)
    episodes: int | None = field(default=None, at_least=1)
    log_every: int | None = field(default=None, at_least=1)
    seed: int = field(default=0, at_least=0)
    exact: bool = False
    backend: Backend = field(default="auto", static=True)
    out: Path | None = None
    dry_run: bool = False


OF_SEARCH = (
    "--draws",
    "--budget",
    "--one-in",
    "--rungs",
    "--grow",
    "--sampler",
    "--rounds",
    "--seeds",
    "--fresh-seeds",
    "--steps",
    "--episodes",
    "--log-every",
    "--seed",
    "--exact",
    "--backend",
)


def search_command(argv: list[str]) -> int:
    prepare()
    groups = groups_in(argv, RANGES, ENVIRONMENT)
    options, typed = parse(Search, argv, **groups)
    with busy("reading what is to be searched", options.quiet):
        wanted = _wanted(options, typed, **groups)
    start_jax()
    labels = [method["label"] for method in wanted.experiment.method]
    if options.dry_run:
        work = {label: {"settings": wanted.settings(label), "work": wanted.work(label)} for label in labels}
        if options.json:
            print_json({"rungs": [rung._asdict() for rung in wanted.ladder], "methods": work})
        else:
            _say(wanted)
        return 0
    if not options.quiet and not options.json:
        _say(wanted)
    about = {"memory": options.bytes, "command": shlex.join([PROG, "search", *argv])}
    with watched(options, options.out) as watch:
        del watch["looked"]  # nothing is compared until all is decided
        outcome = runner.search(wanted, options.out, **about, **watch)
    say_where_of(outcome, options.out, options)
    return 0


def _say(wanted: search.Search) -> None:
    """What is to be searched, for people."""
    print(*(wanted.in_words(method["label"]) for method in wanted.experiment.method), sep="\n")
    print(f"then what is found of each runs on {wanted.halving.fresh_seeds} fresh seeds")


def _wanted(
    options: Search, typed: Mapping[str, Typed], hyperparameters: Classes, environment: Classes
) -> search.Search:
    """The search that is in a file, or was typed."""
    if is_typed_as_file(options, typed, OF_SEARCH):
        return search.Search.load(options.env)
    find(environment, options.env)
    for name in options.methods or ("",):
        find(hyperparameters, name)
    methods = methods_typed(options.methods, typed["hyperparameters"], hyperparameters)
    is_random = any(isinstance(x, Random) for table in methods for x in table.values())
    unsaid = is_random and options.draws is None and options.budget is None
    return search.Search(
        several_of([options.env], typed["environment"], environment),
        methods,
        **length_typed(options, typed["options"]),
        draws=DRAWS if unsaid else options.draws,
        budget=options.budget,
        one_in=options.one_in,
        rungs=options.rungs,
        grow=options.grow,
        sampler=options.sampler,
        rounds=options.rounds,
        fresh_seeds=options.fresh_seeds,
        seeds=options.seeds,
        log_every=options.log_every,
        seed=options.seed,
        exact=options.exact,
        backend=options.backend,
    )
