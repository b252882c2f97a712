"""`jaxrl-tab seeds`: how many seeds a comparison takes, from the runs of a sweep."""

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from jaxrl_tab.cli.printed import print_table
from jaxrl_tab.cli.screen import busy
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import parse, word
from jaxrl_tab.core.errors import InputError, as_path
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.experiment.storage import DATA, FRESH_DATA
from jaxrl_tab.show.words import six_digits

if TYPE_CHECKING:
    import xarray as xr


@checked_dataclass
class Seeds:
    """How many common seeds show a true difference of mean scores, judged by the runs of a sweep.

    For each two methods, at their best settings: experiments are drawn from their runs, seed by seed, and compared as
    a sweep compares them. Fresh seeds are taken where the sweep has some (--select). It knows what these runs show, and
    no more: of few, the number is a guess. `sweep --until-decided` needs no such number.

    Examples:
      jaxrl-tab seeds runs/windy --difference 0.5
      jaxrl-tab seeds runs/windy --difference 0.5 --power 0.8 --json

    Attributes:
        folder: The folder of the sweep: what --out named.
        difference: The least difference of mean scores that should be seen.
        power: The probability that it is seen.
        json: Print JSON.
    """

    folder: str = word("DIR")
    difference: float | None = field(default=None, greater_than=0)
    power: float = field(default=0.9, greater_than=0, less_than=1)
    json: bool = False


def seeds_command(argv: list[str]) -> int:
    options, _ = parse(Seeds, argv)
    if not options.folder:
        raise InputError("name the folder of a sweep")
    if options.difference is None:
        raise InputError("give --difference: the least difference of mean scores that should be seen")
    with busy("drawing experiments"):
        rows = list(_rows(as_path("the folder", options.folder), options.difference, options.power))
    if options.json:
        asked = {"difference": options.difference, "power": options.power}
        print_json({"folder": options.folder, **asked, "pairs": rows})
        return 0
    table = Table("environment", "methods", "pilot\nseeds", "sd of the\ndifferences", "seeds")
    for column in table.columns[2:]:
        column.justify = "right"
    for row in rows:
        told = f"more than {row['seeds']:,}" if row["is_more"] else f"{row['seeds']:,}"
        table.add_row(
            row["environment"], " – ".join(row["methods"]), str(row["pilot"]), six_digits(row["sd"]), told
        )
    from jaxrl_tab.stats import unseen

    out = console()
    print_table(out, table)
    fewest = min(row["pilot"] for row in rows)
    out.print(
        f"So many common seeds show a true difference of {options.difference:g} in {options.power:.0%} of experiments, "
        f"judged by these runs: {unseen(fewest)} stuck, which {fewest} seeds need not show.",
        markup=False,
    )
    return 0


def _rows(folder: Path, difference: float, power: float) -> Iterator[dict[str, Any]]:
    """What there is to tell of each two methods of each environment."""
    from jaxrl_tab import stats
    from jaxrl_tab.stats import export
    from jaxrl_tab.stats.pilot import LARGEST

    file = next((x for x in (folder / FRESH_DATA, folder / DATA) if x.is_file()), None)
    if file is None:
        raise InputError(f"there is no finished sweep in {folder}: neither {FRESH_DATA} nor {DATA}")
    by_environment: dict[str, dict[str, xr.Dataset]] = {}
    for name, ds in export.load(file).items():
        environment, _, method = name.rpartition("/")
        own = by_environment.setdefault(environment or str(ds.attrs["environment"]), {})
        own[method] = ds.sel(stats.best(ds))
    if all(len(methods) < 2 for methods in by_environment.values()):
        raise InputError(f"{folder} has one method alone: two are compared")
    for environment, methods in by_environment.items():
        yield from _of_pairs(environment, methods, difference, power, LARGEST)


def _of_pairs(
    environment: str, methods: "Mapping[str, xr.Dataset]", difference: float, power: float, largest: int
) -> Iterator[dict[str, Any]]:
    from jaxrl_tab import stats

    pairs = list(itertools.combinations(methods, 2))
    worst = min(float(stats.standstill(ds).min()) for ds in methods.values())
    seeds = min(ds.sizes["seed"] for ds in methods.values())  # one that was decided early may have fewer
    scores = {name: stats.scored(ds.isel(seed=slice(seeds))) for name, ds in methods.items()}
    for first, second in pairs:
        if scores[first].mean() < scores[second].mean():
            first, second = second, first  # the better one first
        x, y = scores[first], scores[second]
        n = stats.seeds_from_pilot(
            x, y, difference, power=power, confidence=1 - 0.05 / len(pairs), worst=worst
        )
        sd = float((x - y).std(ddof=1))
        about = {"environment": environment, "methods": [first, second], "pilot": seeds, "sd": sd}
        yield about | {"seeds": n, "is_more": n >= largest}
