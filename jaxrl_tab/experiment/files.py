"""The files of results in an experiment's folder."""

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, get_args

from jaxrl_tab.core.checks import is_list
from jaxrl_tab.core.errors import InputError, RunError, check_choice, one_line, unfit
from jaxrl_tab.core.memory import words
from jaxrl_tab.core.netcdf import save_all
from jaxrl_tab.core.notebook import table
from jaxrl_tab.core.types import Environment
from jaxrl_tab.core.version import __version__
from jaxrl_tab.engine import provenance
from jaxrl_tab.envs import ENVIRONMENT
from jaxrl_tab.experiment import disk, painter, storage
from jaxrl_tab.experiment.records import mixture, origins_of, recorded, timestamp
from jaxrl_tab.experiment.storage import (
    AS_WRITTEN,
    DATA,
    FRESH_DATA,
    SEARCH,
    SELECTION,
    SUMMARY,
    VERDICT,
    Store,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from jaxrl_tab.engine.part import Part
    from jaxrl_tab.experiment.searching import Tried
    from jaxrl_tab.show.explained import Explanation
    from jaxrl_tab.show.explorer.over_time import Again
    from jaxrl_tab.show.report import Page
    from jaxrl_tab.stats.columns import Methods
    from jaxrl_tab.stats.deciding import Verdict
    from jaxrl_tab.stats.tasks import Tasks


@dataclass(frozen=True)
class Outcome:
    """What an experiment gave.

    Attributes:
        datasets: `SweepResult.to_xarray` of each part, by its name "ENVIRONMENT/METHOD".
        fresh: the same of the setting chosen for each part, on fresh seeds; empty without selection.
        envs: the environments by their names.
        parts: what was run, by the same names as the datasets.
        verdicts: what was decided in each environment, where methods were compared until all was.
        tried: what a search tried, where one found the settings.
    """

    datasets: "dict[str, xr.Dataset]"
    fresh: "dict[str, xr.Dataset]"
    envs: dict[str, Environment]
    parts: "Mapping[str, Part]" = field(default_factory=dict)
    verdicts: "dict[str, Verdict]" = field(default_factory=dict)
    tried: "tuple[Tried, ...]" = ()

    def __repr__(self) -> str:
        return f"<Outcome: {one_line(', '.join(self.datasets))}>"

    def _repr_html_(self) -> str:
        from jaxrl_tab.show.rows import chosen

        tables = []
        for label, methods in self.methods.items():
            best = chosen(methods, self.fresh_methods.get(label))
            tables.append(table(f"{label}: the best setting of each method", best.head, best.rows))
        return "\n".join(tables)

    def report(self) -> "Page":
        """The report, to look around in: a notebook shows it, and its `save` writes it into a file.

        In the folder of the experiment it also has what was learned at the moments before.
        """
        from jaxrl_tab.show import report

        about = {"made by": repr(self), "versions": provenance.installed()}
        seen = {"explained": self.explained_in_report, "verdicts": self.verdicts, "tried": self.tried}
        return report.page(self.methods, about, self.fresh_methods, **seen)

    def explain(self) -> "Explanation":
        """Where each method, at its best setting, loses what it earns less than the best policy: `SweepResult.explain`.

        It is of all seeds, unless these are very many.
        """
        from jaxrl_tab.engine.explain import explain

        return explain(self.methods, self.parts)

    @property
    def explained_in_report(self) -> "Explanation":
        """The same of no more seeds than a report has time for."""
        from jaxrl_tab.engine.explain import IN_REPORT, explain

        return explain(self.methods, self.parts, most=IN_REPORT)

    @cached_property
    def methods(self) -> "dict[str, Methods]":
        """The datasets of each environment, with all that is worked out of them."""
        from jaxrl_tab.stats.columns import by_environment

        return by_environment(self.datasets, self.envs)

    @cached_property
    def fresh_methods(self) -> "dict[str, Methods]":
        """The same of the fresh seeds."""
        from jaxrl_tab.stats.columns import by_environment

        return by_environment(self.fresh, self.envs)

    @cached_property
    def tasks(self) -> "Tasks | None":
        """The methods over all environments, on fresh seeds where all were run on some: see `stats.across_tasks`.

        None where there are not two of them in which methods can be compared.
        """
        from jaxrl_tab import stats

        on_fresh = self.fresh.keys() == self.datasets.keys()
        try:
            return stats.across_tasks(self.fresh_methods if on_fresh else self.methods)
        except InputError:
            return None

    @property
    def chosen(self) -> dict[str, int]:
        """For each part the number of the configuration with the best score."""
        return {
            f"{label}/{name}": own.number_of_best
            for label, methods in self.methods.items()
            for name, own in methods.settings.items()
        }

    @cached_property
    def summary(self) -> "pd.DataFrame":
        """`stats.summary` of all environments; their names are a column where there are several."""
        import pandas as pd

        tables = {label: methods.summary for label, methods in self.methods.items()}
        if len(tables) > 1:
            tables = {label: pd.DataFrame({"environment": label} | dict(x)) for label, x in tables.items()}
        return pd.concat(tables.values(), ignore_index=True)

    @cached_property
    def selection(self) -> "pd.DataFrame":
        """The setting chosen for each part: its score on the seeds that it was chosen on, and on fresh ones.

        Returns:
            A frame with the columns `environment`, `method`, the hyperparameters that were swept, `chosen_score`
            with `chosen_low` and `chosen_high`, which flatter it, and `fresh_score` with `fresh_low` and
            `fresh_high`, which do not; the intervals are of the mean, 95%.
        """
        import pandas as pd

        from jaxrl_tab import stats

        rows = []
        for name in self.fresh:
            environment, _, method = name.partition("/")
            own, fresh = (x[environment].settings[method] for x in (self.methods, self.fresh_methods))
            setting, chosen, rerun, _ = stats.selection(own, fresh)
            row = {"environment": environment, "method": method, **stats.named(own.ds, setting)}
            for kind, interval in (("chosen", chosen), ("fresh", rerun)):
                row |= {f"{kind}_score": float(interval.estimate)}
                row |= {f"{kind}_low": float(interval.low), f"{kind}_high": float(interval.high)}
            rows.append(row)
        # Not all methods have all hyperparameters.
        names = dict.fromkeys(name for row in rows for name in row)
        scores = [name for name in names if name.startswith(("chosen_", "fresh_"))]
        return pd.DataFrame(rows, columns=[*(name for name in names if name not in scores), *scores])

    @property
    def search(self) -> "pd.DataFrame":
        """What a search tried, a row for each setting in each rung.

        Returns:
            A frame with the columns of `searching.Tried`, where each hyperparameter that was searched has one of its
            own; empty where there was no search.
        """
        import pandas as pd

        names = dict.fromkeys(name for one in self.tried for name in one.setting)
        rows = [one._asdict() | {name: one.setting.get(name) for name in names} for one in self.tried]
        first, last = (
            ["method", "trial"],
            ["round", "rung", "length", "seeds", "by", "score", "lost", "goes_on"],
        )
        return pd.DataFrame(rows, columns=[*first, *names, *last])

    @property
    def verdict(self) -> "pd.DataFrame":
        """What is known of each two methods that were compared until all was decided.

        Returns:
            A frame with the columns `environment`, and those of `stats.Pair`.
        """
        import pandas as pd

        rows = [
            {"environment": label, **pair._asdict()}
            for label, verdict in self.verdicts.items()
            for pair in verdict.pairs
        ]
        return pd.DataFrame(rows)


Format: TypeAlias = Literal["png", "svg", "pdf"]
FORMATS: tuple[Format, ...] = get_args(Format)


def check_formats(formats: Any) -> tuple[Format, ...]:
    """Formats of pictures, each once; none for no pictures. Raises InputError where one is not of `FORMATS`."""
    if isinstance(formats, str) or not is_list(formats):
        raise unfit(None, "formats", f"a list of some of {', '.join(FORMATS)}", formats)
    for one in formats:
        check_choice(None, "formats", one, FORMATS)
    return tuple(dict.fromkeys(formats))


def drawn_as(records: Mapping[str, Any]) -> tuple[Format, ...]:
    """The formats of the pictures that the last session was to draw, by the records of a folder."""
    said = records["sessions"][-1].get("formats") if records["sessions"] else None
    return tuple(x for x in FORMATS if x in said) if isinstance(said, list) else FORMATS[:1]


class Pictures(NamedTuple):
    """Pictures that are being drawn.

    Attributes:
        folder: into which; it is there for a while only.
        finish: returns when all are drawn.
    """

    folder: Path
    finish: Callable[[], None]


@contextlib.contextmanager
def drawing(store: Store, outcome: Outcome, formats: Sequence[Format] = FORMATS[:1]) -> Iterator[Pictures]:
    """Within the block the pictures are drawn, in these formats, for `write_files` to put where they belong."""
    scratch = store.path / f".{storage.PICTURES}{disk.UNFINISHED}"
    try:
        with painter.drawing(_drawings(outcome, scratch, formats) if formats else ()) as finish:
            yield Pictures(scratch, finish)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def write_files(
    store: Store,
    outcome: Outcome,
    records: Mapping[str, Any],
    pictures: Pictures,
    again: "Again | None" = None,
    toml: Mapping[str, str] | None = None,
    history: Sequence[tuple[str, str, str]] = (),
) -> None:
    """Tables, pictures, and the report, each a whole file or none.

    `again` and `toml` are for the report, see `report.write`; so is the `history`, as `Found` has it.
    """
    from jaxrl_tab.show import report

    folder, scratch = store.path, pictures.folder
    about = {"command": records["sessions"][0]["command"], "version": __version__}
    with disk.as_run_error(folder):
        scratch.mkdir(parents=True, exist_ok=True)
        files = [_write_data(folder / DATA, outcome.datasets, outcome, about)]
        files.append(_write_table(folder / SUMMARY, outcome.summary))
        if outcome.fresh:
            files.append(_write_data(folder / FRESH_DATA, outcome.fresh, outcome, about))
            files.append(_write_table(folder / SELECTION, outcome.selection))
        if outcome.tried:
            files.append(_write_table(folder / SEARCH, outcome.search))
        if outcome.verdicts:
            files.append(_write_table(folder / VERDICT, outcome.verdict))
        about_all = _about(store, records, history)
        explained, fresh = outcome.explained_in_report, outcome.fresh_methods
        more = again, toml, explained, outcome.verdicts, outcome.tried
        report.write_methods(scratch, outcome.methods, about_all, fresh, *more)
        pictures.finish()
    for file in sorted(path for path in scratch.rglob("*") if path.is_file()):
        goal = folder / file.relative_to(scratch)
        with disk.as_run_error(goal):
            goal.parent.mkdir(parents=True, exist_ok=True)
        with disk.writing(goal) as unfinished:
            file.replace(unfinished)
        files.append(goal)
    store.keep_files(str(file.relative_to(folder)) for file in files)


def _drawings(outcome: Outcome, folder: Path, formats: Sequence[Format]) -> list[painter.Drawing]:
    """The pictures of each environment; where there are several, each has a folder of its own."""
    from jaxrl_tab.show.searched import ways

    names = disk.file_names(outcome.envs)
    several = len(outcome.envs) > 1
    place = {label: folder / storage.PICTURES / names[label] if several else folder for label in outcome.envs}
    first = next(iter(outcome.methods))  # in which settings were searched, if they were
    return [
        painter.Drawing(
            methods, outcome.envs[label], place[label], formats, ways(outcome.tried) if label == first else ()
        )
        for label, methods in outcome.methods.items()
    ]


def _write_data(file: Path, datasets: "Mapping[str, xr.Dataset]", outcome: Outcome, about: Any) -> Path:
    """A netCDF file with a group for each part: ENVIRONMENT/METHOD; METHOD where there is one environment."""
    needed = sum(ds.nbytes + 2**14 for ds in datasets.values())  # if it cannot be compressed
    if needed > (room := shutil.disk_usage(file.parent).free):  # HDF5 may crash where the disk becomes full
        raise RunError(
            f"{file} could not be written: it may need {words(needed)} on the disk, and there is room for "
            f"{words(room)}"
        )
    with disk.writing(file) as unfinished:
        groups = (
            datasets if len(outcome.envs) > 1 else {x.partition("/")[2]: ds for x, ds in datasets.items()}
        )
        save_all(groups, unfinished, about)
    return file


def _write_table(file: Path, table: "pd.DataFrame") -> Path:
    with disk.writing(file) as unfinished:
        table.to_csv(unfinished, index=False)
    return file


def _about(
    store: Store, records: Mapping[str, Any], history: Sequence[tuple[str, str, str]]
) -> dict[str, Any]:
    """How the results came about, for the report."""
    with disk.as_run_error(store.path / AS_WRITTEN, "read"):
        as_written = (store.path / AS_WRITTEN).read_text(encoding="utf-8", errors="replace")
    first, last = records["sessions"][0], records["sessions"][-1]
    sessions, origins = len(records["sessions"]), origins_of(store)
    grown = max(1, len(history))
    added = {str(i): f"{time}: {what} ({by})" for i, (time, what, by) in enumerate(history, 1)}
    computed = recorded(records, origins)
    session = (computed or [last])[0]  # the last session may have computed no shard
    surroundings = session["surroundings"]
    packages = (*provenance.installed(), *ENVIRONMENT.libraries)
    return {
        "command": first["command"],
        "experiment": as_written,
        "fingerprint": store.fingerprint,
        "started": first["started"],
        "finished": timestamp(),
        **({"interrupted": f"{sessions - grown} times"} if sessions > grown else {}),
        **({"history": added} if grown > 1 else {}),
        **({"mixed": mixed} if len(origins) > 1 and (mixed := mixture(computed)) else {}),
        "versions": {x: surroundings[x] for x in packages if x in surroundings}
        | {"python": session.get("python")},
        "XLA flags": surroundings["XLA_FLAGS"],
        "computed on": f"{session.get('processor')}, {session.get('devices')} devices, "
        f"{session.get('platform')}",
        **({"git commit": session["git_commit"]} if session.get("git_commit") else {}),
    }
