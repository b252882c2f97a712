"""Looking around in the report, in a browser: what it shows are the numbers of the results."""

import dataclasses
import json

import numpy as np
import pytest
from browser import Browser, needs_browser
from looking import at_cursor, choose, column_of, look_at, number, slide
from made_up import make_result
from PIL import Image

import jaxrl_tab as rl
from jaxrl_tab import report, stats
from jaxrl_tab.show import learning

pytestmark = needs_browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture
def page(browser, explored):
    """The browser with the report open. Nothing may be wrong in the end, and nothing may have been loaded."""
    look_at(browser, explored[0])
    yield browser
    assert browser.messages == []
    assert browser.requests == [f"file://{explored[0]}"]


def merged(x, every=3):
    return np.stack([x[..., i : i + every].sum(-1) for i in range(0, x.shape[-1], every)], -1)


def test_the_slider_moves_the_curves_with_it(page, explored):
    """Numbers at three moments, of two measures. Broken once: the point after the time -> fails."""
    ds = {name.partition("/")[2]: ds for name, ds in explored[1].datasets.items()}
    best = {
        "Sarsa": ds["sarsa"].sel(stats.best(ds["sarsa"])),
        "Q-learning": ds["q-learning"].sel(stats.best(ds["q-learning"])),
    }
    choose(page, ".curves", "measure", "reward")
    for moment in (0, 16, 33):
        slide(page, moment)
        assert page("$('output').textContent").startswith(
            f"{min(2000, 60 * (moment + 1)):,}".replace(",", "\u202f")
        )
        expected = {
            name: float((merged(x.rewards.values) / merged(x.steps.values)).mean(0)[moment])
            for name, x in best.items()
        }
        assert at_cursor(page) == pytest.approx(expected, rel=1e-5)
    choose(page, ".curves", "measure", "episodes")
    expected = {name: float(x.episodes.values.sum(-1).mean()) for name, x in best.items()}
    assert at_cursor(page) == pytest.approx(expected, rel=1e-5)


def test_the_slider_moves_the_grid(page):
    """Q at a moment is that of a run that records it. Broken once: rows and cells in another order -> fails."""
    slide(page, 20)
    assert page("$('.stage h5').textContent").startswith("Q-learning, α = ")
    alpha = float(page("$('.stage h5').textContent").rpartition(" ")[2])
    env = rl.make("windy-gridworld")
    again = rl.sweep(
        env, "q-learning", {"alpha": alpha}, num_seeds=8, num_steps=1260, log_every=1260,
        record=lambda state: {"table": state.q}, progress=False,
    )  # fmt: skip
    assert again.log.recorded is not None
    recorded = np.asarray(again.log.recorded["table"])[:, 0]
    exact = rl.planning.value_iteration(env)[1]
    for s in (30, 33, 20):
        page(f"$('.cell[data-s=\"{s}\"]').dispatchEvent(new Event('pointerenter'))")
        assert column_of(page, "learned") == pytest.approx(recorded[:, s].mean(0), abs=0.006)
        assert column_of(page, "exact") == pytest.approx(exact[s], abs=0.006)
        assert sum(column_of(page, "times taken")) <= 1260
    choose(page, ".chosen", "runs", "median")
    page.wait("$('.stage .small').textContent.startsWith('median')")
    assert column_of(page, "learned") == pytest.approx(np.median(recorded[:, 20], 0), abs=0.006)


def test_visits_are_as_many_as_steps(page):
    """Of a single run the numbers of all states add up to the time. Broken once: the vote in place of N -> fails."""
    choose(page, ".chosen", "runs", "best")
    choose(page, ".learned", "colour", "visits")
    page.wait("$('.stage .small').textContent.includes('(best)')")
    slide(page, 9)
    texts = page("$$('.above .v').map(x => x.textContent)")
    assert sum(number(text) for text in texts if text) == 600


def test_settings_against_a_hyperparameter(page, explored):
    """Broken once: the axes in the wrong order -> fails."""
    ds = explored[1].datasets["windy-gridworld/sarsa"]
    mean, low, high, _ = stats.score_interval(ds)
    best = stats.best(ds)
    numbers = "[+x.dataset.value, +x.dataset.low, +x.dataset.high]"
    points = f"Object.fromEntries($$('.settings .point').map(x => [x.dataset.setting, {numbers}]))"
    shown = page(points)
    for i, alpha in enumerate(ds.alpha.values):
        setting = f"0-{2 * i + [0.1, 0.4].index(best['epsilon'])}"
        at = {"alpha": alpha, "epsilon": best["epsilon"]}
        assert shown[setting] == pytest.approx([float(x.sel(at)) for x in (mean, low, high)], rel=1e-5)
    choose(page, ".chosen", "method", "0")
    choose(page, ".settings", "on the axis", "epsilon")
    choose(page, ".settings", "a curve for each", "alpha")
    for i in range(4):
        interval = [float(x.values.ravel()[i]) for x in (mean, low, high)]
        assert page(points)[f"0-{i}"] == pytest.approx(interval, rel=1e-5)
    choose(page, ".settings", "picture", "heat")
    values = page("$$('.settings .point').map(x => [x.dataset.setting, +x.dataset.value])")
    assert dict(values) == pytest.approx(
        {f"0-{i}": float(mean.values.ravel()[i]) for i in range(4)}, rel=1e-5
    )
    page("$('.settings .point[data-setting=\"0-1\"]').dispatchEvent(new Event('click'))")
    page.wait("$('.explorer').dataset.tables === '0-1'")
    assert "ε = 0.4" in page("$('.stage h5').textContent")


def test_the_address_keeps_the_choice(page, explored):
    """What is in it may be anything. Broken once: the measure is left out -> fails."""
    choose(page, ".chosen", "method", "0")
    choose(page, ".curves", "measure", "length")
    choose(page, ".settings", "score", "episodes")
    slide(page, 4)
    page("$('.legend button').click()")
    address = page("location.hash")
    shown = "['.legend', '.curves .body', '.about', '.settings .body'].map(x => $(x).textContent)"
    before = page(shown)
    look_at(page, explored[0], address)
    assert page(shown) == before
    assert page("location.hash") == address
    look_at(
        page,
        explored[0],
        "#1.measure=nothing&1.moment=99&1.setting-0=7&1.cell=-1&1.view=__proto__&2.x=1&1.runs=1",
    )
    assert page("$('output').textContent").startswith("2\u202f000 of")


def test_curves_can_be_switched_off(page):
    """Broken once: all are drawn -> fails."""
    before = page("$$('.curves .line.main, .curves .plot .line').length")
    assert before
    page("$('.legend button').click()")
    assert list(at_cursor(page)) == ["Q-learning"]
    assert page("$('.legend button').getAttribute('aria-pressed')") == "false"
    page("$('.legend button').click()")
    assert list(at_cursor(page)) == ["Sarsa", "Q-learning"]


def test_the_table_sorts_filters_and_picks(page, explored):
    """Broken once: upwards first -> fails."""
    cells = "$$('table.settings tbody tr').map(row => [...row.cells].map(cell => cell.textContent))"
    heads = page("$$('table.settings thead th').map(x => x.textContent)")
    at = heads.index("episodes")
    button = f"$$('table.settings thead button')[{at}]"
    page(f"{button}.click()")
    episodes = [float(row[at]) for row in page(cells)]
    means = [ds.episodes.sum("row").mean("seed").values.ravel() for ds in explored[1].datasets.values()]
    assert episodes == pytest.approx(sorted(np.concatenate(means), reverse=True), abs=0.06)
    assert page(f"{button}.closest('th').getAttribute('aria-sort')") == "descending"
    page(f"{button}.click()")
    assert [float(row[at]) for row in page(cells)] == episodes[::-1]
    page("(x => { x.value = 'sarsa 0.4'; x.dispatchEvent(new Event('input')) })($('input[type=search]'))")
    assert {row[0].rstrip(" ★≈") for row in page(cells)} == {"Sarsa"}
    assert len(page(cells)) == 2
    setting = page("$('table.settings tbody tr').dataset.setting")
    page("$('table.settings .pick').click()")
    page.wait(f"$('.explorer').dataset.tables === '{setting}'")


def test_a_setting_as_toml_is_an_experiment(page, explored, tmp_path):
    """It runs, and gives the same. Broken once: with the values of the axes beside it -> fails."""
    row = "$$('table.settings tbody tr').find(row => row.dataset.setting === '0-1')"
    page(f"{row}.querySelector('td:last-child button').click()")
    (tmp_path / "one.toml").write_text(page("$('dialog pre').textContent"), encoding="utf-8")
    page("$('dialog').close()")
    one = rl.run(rl.Experiment.load(tmp_path / "one.toml"), progress=False).datasets["windy-gridworld/sarsa"]
    whole = explored[1].datasets["windy-gridworld/sarsa"].sel(alpha=0.3, epsilon=0.4)
    np.testing.assert_array_equal(one.returns, whole.returns)


@pytest.fixture
def copied(page, explored, tmp_path, monkeypatch):
    """Runs the lines of Python of a card beside the results, and gives the axes that they draw."""
    import matplotlib.pyplot as plt

    from jaxrl_tab.core.netcdf import save

    for name, ds in explored[1].datasets.items():
        save(ds, name.partition("/")[2], tmp_path / "results.nc", {})
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setattr(plt.Figure, "savefig", lambda *a: None)

    def run(card):
        page(f"$$('{card} button').find(x => x.textContent === 'as Python').click()")
        names = {}
        exec(compile(page("$('dialog pre').textContent"), card, "exec"), names)
        page("$('dialog').close()")
        return names["ax"]

    yield run
    plt.close("all")


def test_curves_can_be_copied_as_python(page, copied):
    """What they draw is what is shown. Broken once: a name of a group that is not there; no single run -> fails."""
    last = lambda ax: {x.get_label(): x.get_ydata()[-1] for x in ax.get_lines() if x.get_label()[0] != "_"}
    choose(page, ".curves", "bands", "all")
    choose(page, ".curves", "measure", "episodes")
    assert last(copied(".curves")) == pytest.approx(at_cursor(page), rel=1e-5)
    choose(page, ".curves", "bands", "none")
    choose(page, ".curves", "a curve for each", "alpha")
    for view in ("median", "best", "worst"):
        choose(page, ".chosen", "runs", view)
        assert last(copied(".curves")) == pytest.approx(at_cursor(page), rel=1e-5)
    choose(page, ".curves", "measure", "return")
    page(
        "$$('.curves input[type=checkbox]').forEach(box => box.click())"
    )  # logarithmic time, and single runs
    choose(page, ".curves", "vertical axis", "log")
    ax = copied(".curves")
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "symlog")
    assert (
        len(ax.get_lines()) == len(at_cursor(page)) + 1 + 5 + 1
    )  # the mean beside one run, five runs, the optimum


def test_settings_can_be_copied_as_python(page, copied):
    """Of a method, of the values of another hyperparameter, as a heat map. Broken once: always of methods -> fails."""
    value = "[...$$('.settings .point')].map(x => +x.dataset.value)"
    places = lambda ax: [y for bars in ax.containers for y in bars.lines[0].get_ydata()]
    for score in ("score", "interim", "episodes"):
        choose(page, ".settings", "score", score)
        assert places(copied(".settings")) == pytest.approx(page(value), rel=1e-5)
    choose(page, ".chosen", "method", "0")
    choose(page, ".settings", "on the axis", "epsilon")
    choose(page, ".settings", "a curve for each", "alpha")
    assert places(copied(".settings")) == pytest.approx(page(value), rel=1e-5)
    choose(page, ".settings", "picture", "heat")
    [image] = copied(".settings").get_images()
    assert image.get_array().T.ravel().tolist() == pytest.approx(page(value), rel=1e-5)


def test_two_methods_stand_side_by_side_in_step(page):
    """Broken once: the first alone moves -> fails."""
    choose(page, ".learned", "beside it", "0")
    page.wait("$$('.stage').length === 2")
    slide(page, 7)
    assert page("$$('.stage .small').filter(x => x.textContent.includes('after 480')).length") == 2
    page("$('.cell[data-s=\"12\"]').dispatchEvent(new Event('pointerenter'))")
    assert page("$$('.about h6').map(x => x.textContent)") == ["Row 1, column 2"] * 2


def test_it_works_by_keyboard(page):
    """Broken once: the arrow upwards goes to the left -> fails."""
    page("$('.player input').focus()")
    for key, moment in (("Home", 0), ("ArrowRight", 1), ("ArrowRight", 2), ("End", 33)):
        page.key(key)
        assert page("+$('.player input').value") == moment
    page("$('.cell[tabindex=\"0\"]').focus()")
    page.key("ArrowUp")
    assert page("document.activeElement.dataset.s") == "20"
    assert page("$('.about h6').textContent") == "Row 2, column 0"
    page("$('.settings .point[data-setting=\"1-0\"]').focus()")
    page.key("Enter", "\r")
    page.wait("$('.explorer').dataset.tables === '1-0'")


def test_it_plays(page):
    """Broken once: each time the same moment -> fails."""
    slide(page, 0)
    page("$('.player button').click()")
    page.wait("+$('.player input').value > 1")
    page("$('.player button').click()")
    assert page("$('.player button').getAttribute('aria-label')") == "Play"


def test_dragging_over_the_curves_moves_time(page):
    """Broken once: a pointer that moves is not followed -> fails."""
    page("$('.curves').scrollIntoView()")
    x, y, width = page("(r => [r.x, r.y + 40, r.width])($('.curves .hit').getBoundingClientRect())")
    page.drag(*((x + share * width, y) for share in (0.1, 0.3, 0.5)))
    assert page("+$('.player input').value") == pytest.approx(16, abs=1)


def test_panels_name_the_actions(browser, tmp_path):
    """Blackjack: what a mean of tables says, and letters of what most seeds would do. Broken once: columns as rows
    -> fails."""
    env = rl.make("blackjack")
    result = rl.sweep(env, "monte-carlo", {"epsilon": 0.2}, num_seeds=3, num_episodes=400, progress=False)
    file = report.write(tmp_path, {"blackjack/monte-carlo": result.to_xarray()}, {"blackjack": env}, {})
    look_at(browser, file)
    tables = env.panels()
    assert browser("$$('.panel .title').map(x => x.textContent)") == [table.title for table in tables]
    states = np.unique(np.concatenate([table.states.ravel() for table in tables])).tolist()
    s = tables[1].states[0, 4]
    browser(f"$('.cell[data-s=\"{states.index(s)}\"]').dispatchEvent(new Event('pointerenter'))")
    name = browser("$('.about h6').textContent")
    assert name == f"No usable ace, player {tables[1].rows[0]}, dealer shows {tables[1].columns[4]}"
    box = "(x => [x.x, x.y])($('.cell[data-s=\"{}\"]').getBoundingClientRect())"
    (x, y), (left, same) = (browser(box.format(states.index(at))) for at in (s, tables[1].states[0, 3]))
    assert (left < x, same) == (True, y)
    assert column_of(browser, "learned") == pytest.approx(result.q[:, s].mean(0), abs=1e-4)
    greedy = result.q[:, s] == result.q[:, s].max(-1, keepdims=True)
    votes = (greedy / greedy.sum(-1, keepdims=True)).sum(0)
    bold = browser("$$('.about .best th').map(x => x.textContent)")
    assert bold == [env.action_names[a] for a in np.flatnonzero(np.isclose(votes, votes.max()))]
    assert browser.messages == []


def test_tasks_without_a_picture_have_a_table_of_states(browser, tmp_path):
    """Broken once: the exact values of all states beside some -> fails."""
    env = rl.RandomWalk()
    result = rl.sweep(env, "td", {"alpha": 0.1}, num_seeds=3, num_episodes=20, exact=True, progress=False)
    look_at(browser, report.write(tmp_path, {"walk/td": result.to_xarray()}, {"walk": env}, {}))
    rows = browser("$$('.stage tbody tr').map(row => [...row.cells].map(cell => cell.textContent))")
    inner = range(1, env.num_states - 1)
    assert [int(row[0].removesuffix(" (start)")) for row in rows] == [*inner]
    assert [number(row[1]) for row in rows] == pytest.approx(result.q[:, 1:-1, 0].mean(0), abs=1e-3)
    exact = [2 * s / (env.num_states - 1) - 1 for s in inner]  # a fair coin between -1 and 1
    assert [number(row[2]) for row in rows] == pytest.approx(exact, abs=1e-3)
    error = result.log.v_error
    assert error is not None
    assert at_cursor(browser) == pytest.approx({"TD(0)": float(error[:, -1].mean())}, rel=1e-5)
    assert browser.messages == []


def test_where_states_cannot_be_counted_there_is_a_map(browser, tmp_path):
    """Colours, and the values of the place that is looked at. Broken once: with numbers in all 315 places -> fails."""
    car, w = rl.MountainCar(), -np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    result = make_result(car, w)
    ds = dataclasses.replace(result, fixed=result.fixed | {"features": "observation"}).to_xarray()
    look_at(browser, report.write(tmp_path, {"car/sarsa": ds}, {"car": car}, {}))
    assert browser("$$('.cell').length") == 315
    assert browser("$('.about h6').textContent") == "Velocity 0, position −0.51"  # where episodes start
    here = (-1.2 + 1.7 * 8.5 / 21 + 0.35) / 0.85  # of -1 to 1
    assert column_of(browser, "learned") == pytest.approx(np.array([0, -1, -2]) * here, abs=0.006)
    texts = "[...new Set([...$$('.above .{}')].map(x => x.textContent))].sort()"
    assert browser(texts.format("v")) == [""]
    assert browser(texts.format("letter")) == [
        "",
        "B",
        "F",
    ]  # none in the middle, where all actions are alike
    for width in (1200, 390):
        browser.resize(width)
        browser.wait("$('.panel').viewBox.baseVal.width > 0")
        inside = "(x => x.getBBox().x >= 0)"
        assert browser(f"[...$$('.panel .tick')].every({inside})")
    assert browser.messages == []


def test_what_features_allow_stands_beside_the_curves(browser, tmp_path):
    """One line where it is the same for all, else one for each; none of an infinite number, and none beside others.

    Broken once: of the settings in the order in which they are ranked -> fails.
    """
    ds = make_result(rl.RandomWalk(states=5), np.zeros((7, 1))).to_xarray()
    errors = dict.fromkeys(("v_error", "value_error"), ds.returns * 0 + 1 / ds.alpha)  # 0.9 is the best
    lines = {"least_value_error": [0.1, 0.1, 0.2], "td_value_error": [0.3, np.nan, 0.3]}
    ds = ds.assign(errors | {name: ("alpha", x) for name, x in lines.items()}).assign_attrs(learns="states")
    look_at(browser, report.write(tmp_path, {"walk/td": ds}, {"walk": rl.RandomWalk(states=5)}, {}))
    told = "[...$$('.legend [data-exact]')].map(x => [x.dataset.exact, x.textContent])"
    assert browser(told) == []
    choose(browser, ".curves", "measure", "value_error")
    assert browser(told) == [["the least possible", "0.2000"], ["fixed point of TD", "0.3000"]]
    choose(browser, ".curves", "a curve for each", "alpha")
    least = [
        ["the least possible, α = " + a, x]
        for a, x in (("0.05", "0.1000"), ("0.2", "0.1000"), ("0.9", "0.2000"))
    ]
    assert browser(told) == [*least, ["fixed point of TD", "0.3000"]]
    dashes = browser("[...$$('.curves .exact')].map(x => getComputedStyle(x).strokeDasharray)")
    assert dashes == ["5px, 4px"] * 3 + ["2px, 3px"]
    browser("$$('.curves button').find(x => x.textContent === 'as Python').click()")
    assert 'ax.axhline(0.3, ls=":", color="grey", label="fixed point of TD")' in browser(
        "$('dialog pre').textContent"
    )
    assert browser.messages == []


def test_text_can_be_read_on_all_colours(page):
    """Contrast of 4.5 or more (WCAG 2.1), in the grid. Broken once: colours as strong as of curves -> fails."""
    contrasts = """(() => {
      const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
      const light = (colour) => {
        for (const style of ["white", colour]) context.fillStyle = style, context.fillRect(0, 0, 1, 1);
        const [r, g, b] = [...context.getImageData(0, 0, 1, 1).data].map(x => x / 255)
          .map(x => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
      };
      const ink = light(getComputedStyle($(".above .v")).fill);
      return $$(".cell .box").map(x => (light(getComputedStyle(x).fill) + 0.05) / (ink + 0.05));
    })()"""
    for colour, moment in (("visits", 33), ("error", 0)):  # in which the strongest colours are
        choose(page, ".learned", "colour", colour)
        page.wait("$('.stage .small').textContent.length > 0")
        slide(page, moment)
        page.wait("$$('.cell .box').every(x => x.getAnimations().length === 0)")
        shown = page(contrasts)
        assert len(shown) == 70
        assert 4.5 <= min(shown) < 7


def test_names_inject_nothing(browser, windy, tmp_path):
    """Names of methods and environments, values and paths. Broken once: JSON with its '<' as it is -> fails."""
    evil = "x</script><!--<img src=x onerror=hacked=1>&amp;\"'`${hacked=1}\u2028"
    q = rl.planning.value_iteration(windy)[1]
    ds = make_result(windy, q).to_xarray()
    ds = ds.assign_coords(alpha=[evil, "</style><script>hacked=1</script>", "glie"])
    ds.attrs["fixed"] = json.dumps({"epsilon": evil, "gamma": 1.0})
    environment = evil.replace("/", "")
    file = report.write(
        tmp_path, {f"{environment}/{evil}": ds}, {environment: windy}, {"path": evil, evil: [evil]}
    )
    look_at(browser, file)
    choose(browser, ".curves", "a curve for each", "alpha")
    browser("$$('button').filter(x => !x.closest('dialog')).forEach(x => x.click())")
    assert browser("typeof hacked") == "undefined"
    assert browser("document.images.length") == 0
    assert browser("document.scripts.length") == browser("$$('body > script').length")
    assert evil.split("&")[0] in browser("document.body.textContent")
    assert browser("$('.stage h5').textContent").startswith(evil[:20])
    assert browser.messages == []
    assert len(browser.requests) == 1


def test_the_page_of_watch_runs_under_its_policy(browser, tmp_path):
    """The policy is that of all pages. Broken once: pictures in the page itself are not allowed -> fails."""
    pictures = [Image.new("RGB", (3, 2), colour) for colour in ("red", "blue")]
    learning.write(tmp_path / "learning.html", pictures, ["first", "<last>"], "it")
    browser.messages.clear()
    browser.open(tmp_path / "learning.html")
    browser.wait("document.getElementById('picture')?.naturalWidth === 3")
    browser.wait("!document.getElementById('controls').hidden")
    browser("$('#moment').value = 0, $('#moment').oninput()")
    assert browser("$('#title').textContent") == "first"
    browser("$('#moment').value = 1, $('#moment').oninput()")
    assert browser("$('#title').textContent") == "<last>"
    assert browser.messages == []


def test_without_scripts_the_tables_are_there(browser, explored):
    """Broken once: what is for such readers is hidden -> fails."""
    browser.scripts(on=False)
    try:
        browser.messages.clear()
        browser.open(explored[0])
        browser.wait("document.readyState === 'complete' && $$('table').length >= 2")
        assert browser("$$('table.settings tbody tr').length") == 7
        assert browser("$('noscript').checkVisibility()")
    finally:
        browser.scripts(on=True)


def test_it_prints(page):
    """Broken once: what one chooses with is printed -> fails."""
    page.media("print")
    try:
        assert page("getComputedStyle($('.controls')).display") == "none"
        assert page("$$('.card svg').length") >= 3
    finally:
        page.media("screen")


@pytest.mark.slow
def test_a_notebook_shows_the_page_in_a_frame(browser, explored, tmp_path):
    """Of a sweep, and of an experiment; what is chosen there works. Broken once: the page is not escaped -> fails."""
    result = rl.sweep(rl.make("windy-gridworld"), "sarsa", {"alpha": [0.3, 1.0]}, num_seeds=3, num_steps=2000)
    for i, shown in enumerate((result.report(), explored[1].report())):
        file = tmp_path / f"{i}.html"
        file.write_text(f"<!doctype html><title>A notebook</title>{shown._repr_html_()}", encoding="utf-8")
        browser.messages.clear()
        browser.open(file)
        inside = "$('iframe').contentDocument"
        browser.wait(f"$('iframe') && {inside}?.querySelector('.explorer')?.dataset.ready === 'yes'")
        slider = f"{inside}.querySelector('.player input')"
        browser(f"(s => {{ s.value = 0; s.dispatchEvent(new Event('input')) }})({slider})")
        title = browser(f"{inside}.querySelector('h1').textContent")
        assert title in shown.title
        assert repr(shown) == f"<Page {shown.title!r}: save('report.html') writes it>"
        assert shown.save(tmp_path / "saved.html").read_text(encoding="utf-8") == shown.html
        assert browser.messages == []
