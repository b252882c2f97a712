"""Results of experiments side by side: `compare`."""

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from jaxrl_tab.core.checks import FRACTION, check_within
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.engine import provenance
from jaxrl_tab.experiment.scores import known_environments
from jaxrl_tab.experiment.sides import Side, side
from jaxrl_tab.experiment.spec import difference

if TYPE_CHECKING:
    import xarray as xr

    from jaxrl_tab.show.compared import Comparison
    from jaxrl_tab.stats.ranking import Ranking

MACHINE = ("device", "instruction set", "processor", "devices", "platform")
SETTINGS = (*provenance.SETTINGS, provenance.BACKEND, "XLA_FLAGS")
IN_ATTRS = ("num_steps", "num_episodes", "log_every", "root_seed")  # of a dataset: what its experiment was


def compare(first: Any, *others: Any, confidence: float = 0.95) -> "Comparison":
    """Lays results beside others: what differs, what is the same to the last bit, what is better or worse.

    Settings that both have are compared on the seeds that both have, seed by seed; where there are fewer than six of
    these, as with another root seed, as runs that have nothing to do with each other. Where what was tried is not
    the same, the best settings are compared as well, and where both have fresh seeds, the chosen ones on these.
    All comparisons, with all others, are one family (Holm): if nothing has become better or worse, the chance that
    anything is called so is at most 1 - `confidence`. Runs that are the same are no comparisons. What is compared is
    `stats.score`: the higher the better, of prediction the lower.

    Methods that only the others have are ranked among those of the first, where both have two environments or more
    in common: see `stats.ranking`.

    Args:
        first: a folder of results, a file of them (`results.nc`), a table as `read` takes it, a file of scores
            (.npz, see `experiment.scores`), or what `run`, `resume`, `sweep` or `read` returned. Folders are only
            looked at; of one that is not finished what is there counts.
        others: the same, one or more, each of which is compared with the first.
        confidence: of all comparisons together.

    Returns:
        What was found: `print` says it in sentences, a notebook shows it, and its `page().save(file)` writes a page.

    Raises:
        InputError: there are no others, results cannot be read, or nothing in them can be compared.
    """
    from jaxrl_tab.show.compared import LETTERS, Beside, Comparison
    from jaxrl_tab.stats.ranking import Ranking
    from jaxrl_tab.stats.settings import Settings
    from jaxrl_tab.stats.versus import compared, is_same_task, versus

    check_within("confidence", confidence, FRACTION)
    if not 0 < len(others) < len(LETTERS):
        raise InputError(f"compare takes two results or more, at most {len(LETTERS)}, not {1 + len(others)}")
    a, *rest = (side(results) for results in (first, *others))
    rest = [_called_as_in(a, b) for b in rest]
    own = {name: Settings(ds) for name, ds in a.datasets.items()}
    families, alone, unlike, rankings = [], [], [], []
    for b in rest:
        both = [name for name in a.datasets if name in b.datasets]
        theirs = {name: Settings(b.datasets[name]) for name in both}
        alike = [
            name
            for name in both
            if is_same_task(a.datasets[name], b.datasets[name])
            and own[name].prediction == theirs[name].prediction
        ]
        on_fresh = [
            n
            for n in a.fresh
            if n in b.fresh and (n in alike or (n not in both and is_same_task(a.fresh[n], b.fresh[n])))
        ]
        fresh = {n: (Settings(a.fresh[n]), Settings(b.fresh[n])) for n in on_fresh}
        rankings.append(_ranking(a, b, confidence))
        families.append(versus({n: own[n] for n in alike}, theirs, fresh))
        alone.append(
            tuple(
                [n for n in x if n not in y] for x, y in ((a.datasets, b.datasets), (b.datasets, a.datasets))
            )
        )
        unlike.append([name for name in both if name not in alike])
    if not any(families) and not any(isinstance(found, Ranking) for found in rankings):
        raise InputError(_nothing(a, rest, unlike, [found for found in rankings if isinstance(found, str)]))
    rows = compared([pair for family in families for pair in family], confidence)
    found = []
    for i, (b, family) in enumerate(zip(rest, families, strict=True)):
        some, rows = rows[: len(family)], rows[len(family) :]
        about = LETTERS[i + 1], b.name, differs(a, b, isinstance(rankings[i], Ranking)), alone[i], unlike[i]
        found.append(Beside(*about, some, b.notes, b.complete, rankings[i]))
    return Comparison(a.name, a.notes, found, confidence, a.complete)


def _ranking(a: Side, b: Side, confidence: float) -> "Ranking | str | None":
    """The methods that only B has among those of A; or why there is no ranking; None where there is nothing to rank."""
    from jaxrl_tab.stats.ranking import ranking
    from jaxrl_tab.stats.settings import Settings

    on_fresh = bool(a.fresh) and (bool(b.fresh) or not a.datasets)
    one, other = (x.fresh if on_fresh else x.datasets for x in (a, b))
    labels = {name.partition("/")[0] for name in one}
    only_b = [
        name for name in (b.fresh or b.datasets) if name not in one and name.partition("/")[0] in labels
    ]
    if len({name.partition("/")[0] for name in only_b}) < 2:
        return None
    if not other:
        return (
            f"{b.name} has no fresh seeds, on which {a.name} has its scores: write [select] into its file, as there, "
            "and run it again"
        )
    methods: list[dict[str, dict[str, xr.Dataset]]] = [{}, {}]
    for own, datasets in zip(methods, (one, other), strict=True):
        for name, ds in datasets.items():
            label, _, method = name.partition("/")
            own.setdefault(label, {})[method] = ds.sel(Settings(ds).best)
    envs = known_environments(a.experiment) | known_environments(b.experiment)
    try:
        return ranking(methods[0], methods[1], envs, on_fresh, confidence)
    except InputError as error:
        return f"the methods that only {b.name} has cannot be ranked: {error}"


def _called_as_in(a: Side, b: Side) -> Side:
    """The second, with its only environment called as in the first: a file does not say what its folder calls it."""
    known = a.experiment and b.experiment
    one, other = ({ds.attrs.get("environment") for ds in x.datasets.values()} for x in (a, b))
    labels = {name.partition("/")[0] for name in a.datasets}
    if known or one != other or len(labels) > 1 or len({name.partition("/")[0] for name in b.datasets}) > 1:
        return b
    (label,) = labels
    called = lambda of: {f"{label}/{name.partition('/')[2]}": ds for name, ds in of.items()}
    return b._replace(datasets=called(b.datasets), fresh=called(b.fresh))


def differs(a: Side, b: Side, ranked: bool = False) -> dict[str, list[str]]:
    """What is not the same in two results, as far as that is known of both; but for methods that are `ranked`."""
    if a.experiment and b.experiment:
        experiment = difference(a.experiment, b.experiment)
        if ranked:
            experiment = [line for line in experiment if not re.fullmatch(r"method .* is (gone|new)", line)]
    else:
        experiment = _difference_of(a.datasets, b.datasets)
    was, now = ({} if x.session is None else _surroundings(x.session) for x in (a, b))
    groups: dict[str, dict[str, str]] = {"versions": {}, "settings": {}, "machine": {}}
    for name, value in now.items() if was else ():
        kind = "machine" if name in MACHINE else "settings" if name in SETTINGS else "versions"
        groups[kind][name] = value
    return {"experiment": experiment} | {kind: provenance.differences(was, x) for kind, x in groups.items()}


def _surroundings(session: Mapping[str, Any]) -> dict[str, str]:
    """All that the record of a session says of versions, settings and the machine, as text."""
    names = ("python", "processor", "devices", "platform", "git_commit")
    own = session.get("surroundings")
    known = {**(own if isinstance(own, dict) else {}), **{n: session[n] for n in names if session.get(n)}}
    return {str(name): str(value) for name, value in known.items()}


def _difference_of(a: "Mapping[str, xr.Dataset]", b: "Mapping[str, xr.Dataset]") -> list[str]:
    """What their datasets say of the experiments."""
    lines = {}
    for name in a.keys() & b.keys():
        was, now = (
            {k: str(ds.attrs[k]) for k in IN_ATTRS if k in ds.attrs} | {"seeds": str(ds.sizes["seed"])}
            for ds in (a[name], b[name])
        )
        lines |= dict.fromkeys(provenance.differences(was, now))
    return list(lines)


def _nothing(a: Side, others: list[Side], unlike: list[list[str]], unranked: list[str]) -> str:
    """Why nothing can be compared."""
    if unranked:
        return f"nothing can be compared: {unranked[0]}"
    has = lambda x: ", ".join(x.datasets or x.fresh)
    if any(unlike):
        return f"nothing can be compared: {unlike[0][0]} is not the same task in {a.name} and in {others[0].name}"
    return f"nothing can be compared: {a.name} has {has(a)}; " + "; ".join(
        f"{x.name} has {has(x)}" for x in others
    )
