"""`jaxrl-tab read`: results that other tools computed."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.markup import escape

from jaxrl_tab.cli.compare import new_file
from jaxrl_tab.cli.screen import busy, print_summary
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.cli.typed import FILE, parse, word
from jaxrl_tab.core.errors import InputError, one_line
from jaxrl_tab.core.pytree import checked_dataclass, field
from jaxrl_tab.experiment import disk
from jaxrl_tab.experiment.reading import Readings, read

if TYPE_CHECKING:
    from jaxrl_tab.stats.columns import Methods


@checked_dataclass
class Read:
    """Results that other tools computed: how good the methods are, and how sure that is.

    Reads tables in long form, a row for each score of each run; or a file for each run, by a pattern in quotes that
    says where in its name method and seed stand. Files are .csv, .tsv, .parquet, .nc, or event files of TensorBoard.
    The higher a score, the better. Nothing is made up: what is missing, there twice, or no number is refused, and so
    are runs with other steps than each other, unless --every collects their scores.

    Examples:
      jaxrl-tab read results.csv
      jaxrl-tab read results.csv --method algo --step timesteps --score return --settings lr
      jaxrl-tab read 'runs/{method}/seed_{seed}.csv' --step t --score r --html theirs.html
      jaxrl-tab read 'logs/{method}_{seed}' --score rollout/ep_rew_mean --every 10000 --until 1000000
      jaxrl-tab read results.parquet --save theirs.nc

    Attributes:
        files: Files, folders of event files, or patterns.
        method: The column of methods.
        seed: The column of seeds, whole numbers.
        step: The column of steps, whole numbers; without it a run has one score.
        score: The column of scores; of event files the tag.
        environment: The column of environments, where there are several; environment, if it is there.
        settings: The columns of hyperparameters.
        given: Columns that the files have not, with their one value, such as method=dqn.
        every: Collect the scores of each so many steps.
        until: The last step that is read.
        unpaired: Take methods that have other seeds than each other.
        html: New file for a page that shows all of it.
        save: New .nc file for all of it, which compare takes, or .csv or .parquet.
        json: Print JSON.
    """

    files: tuple[str, ...] = word("FILE|PATTERN ...", many=True)
    method: str = "method"
    seed: str = "seed"
    step: str = "step"
    score: str = "score"
    environment: str | None = None
    settings: tuple[str, ...] = ()
    given: tuple[str, ...] = ()
    every: int | None = field(default=None, at_least=1)
    until: int | None = field(default=None, at_least=1)
    unpaired: bool = False
    html: FILE = None
    save: FILE = None
    json: bool = False


def read_command(argv: list[str]) -> int:
    options, _ = parse(Read, argv)
    if not options.files:
        raise InputError("name a file of results, or a pattern such as 'runs/{method}/seed_{seed}.csv'")
    page, file = new_file(options.html), new_file(options.save)
    with busy("reading"):
        found = read(
            options.files,
            method=options.method,
            seed=options.seed,
            step=options.step,
            score=options.score,
            environment=options.environment,
            settings=options.settings,
            given=dict(map(_given, options.given)),
            every=options.every,
            until=options.until,
            unpaired=options.unpaired,
        )
        if file:
            from jaxrl_tab.stats import export

            export.save(found, file)
        if page:
            disk.write(page, found.report().html)
    if options.json:
        print_json({"notes": found.notes, "environments": _as_json(found)})
        return 0
    out = console()
    for environment, methods in found.methods.items():
        print_summary(escape(environment), methods)
        for line in _differences(methods):
            out.print(line, markup=False)
    for note in found.notes:
        out.print(f"[yellow]{escape(note)}[/]", soft_wrap=True)
    if file:
        print(f"{file} has all of it")
    if page:
        print(f"{page} shows it")
    return 0


def _differences(methods: "Methods") -> Iterator[str]:
    """How the methods, at their best settings, differ from the best one, in sentences."""
    stars = [row for row in methods.rows if row["best"]]
    best = max(stars, key=lambda row: row["score"][0]).method
    for row in stars:
        if row.method in methods.differences:
            middle, low, high = (f"{float(x):.4g}" for x in row["difference"])
            yield f"{row.method} less {best}, seed by seed: {middle} ({low} to {high}), p = {row['p']:.2g}, corrected."


def _given(text: str) -> tuple[str, str]:
    column, equals, value = text.partition("=")
    if not equals or not column:
        raise InputError(f"--given takes COLUMN=VALUE, such as method=dqn, not {one_line(text)}")
    return column, value


def _as_json(found: Readings) -> dict[str, object]:
    import json

    return {
        label: json.loads(str(methods.summary.to_json(orient="records")))
        for label, methods in found.methods.items()
    }
