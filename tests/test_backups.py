"""Backup diagrams: each method has its own, as a person reads it, and as a picture."""

import json
import math
import re
from collections import Counter

import pytest
from matplotlib.patches import Arc, Circle, Rectangle
from refusals import refused

import jaxrl_tab as rl
from jaxrl_tab import plot
from jaxrl_tab.algorithms import ManyTargets
from jaxrl_tab.cli import main
from jaxrl_tab.core.backups import ACTION, DOTS, END, STATE, Backup, labels, lambda_return, tree
from jaxrl_tab.core.declared import of_method
from jaxrl_tab.core.pytree import pytree
from jaxrl_tab.methods import METHODS, PREDICTION

# --- as a person reads it ------------------------------------------------------------------------------

SHOWN = {
    "q-learning": """
    ●       S, A
    │
    ○       R, S'
  ╱ │ ╲
 ╱╰─┼─╯╲
●   ●   ●   max over a'
""",
    "n-step-td": """
○   S_t
│
●   A_t
│
○   R_t+1, S_t+1
⋮
●   A_t+n-1
│
○   R_t+n, S_t+n

Where a terminal state comes before that, the rewards up to it, and no value.
""",
    "sarsa-lambda-forward": """
1 − λ   (1 − λ) λ   (1 − λ) λ²   ...   λ^(T−t−1)

  ●         ●           ●                  ●
  │         │           │                  │
  ○         ○           ○                  ○
  │         │           │                  │
  ●         ●           ●                  ●
            │           │                  ⋮
            ○           ○                  □
            │           │
            ●           ●
                        │
                        ○
                        │
                        ●

At the end of the episode, all by the Q of its start.
""",
}


@pytest.mark.parametrize("name", SHOWN)
def test_the_text_of_a_diagram(name):
    """Broken once: the arc drawn for "each" -> fails."""
    assert str(METHODS[name].backup) == SHOWN[name].strip("\n")


def test_a_full_backup_is_a_tree():
    assert (
        str(Backup("action, each state, max action"))
        == """\
          ●             s, a
    ┌─────┴─────┐
    ○           ○       mean over r, s', by p
  ╱ │ ╲       ╱ │ ╲
 ╱╰─┼─╯╲     ╱╰─┼─╯╲
●   ●   ●   ●   ●   ●   max over a'"""
    )


def test_only_the_branch_that_was_taken_goes_on():
    """As in tree backups (book, section 7.5): 1 root, 1 state, 3 actions, 1 state, 3 actions."""
    drawn = Backup("action, state, each action, state, each action")
    (levels,) = drawn.levels.values()
    assert Counter(node for _, node in nodes(tree(levels))) == {ACTION: 7, STATE: 2}
    assert drawn.diagram()[5:8] == ["●   ●   ●   mean over a_t+1, by π", "    │", "    ○       R_t+2, S_t+2"]


# --- each method has the right one ---------------------------------------------------------------------

SARSA, TD0 = ("action, state, action",), ("state, action, state",)
SHAPES = {
    "sarsa": SARSA,
    "q-learning": ("action, state, max action",),
    "expected-sarsa": ("action, state, each action",),
    "monte-carlo": ("action, state, action, ..., end",),
    "n-step-sarsa": ("action, state, action, ..., state, action",),
    "n-step-expected-sarsa": ("action, state, action, ..., state, each action",),
    "n-step-off-policy-sarsa": ("action, state, action, ..., state, action",),
    "tree-backup": ("action, state, each action, ..., state, each action",),
    "double-q-learning": ("action, state, max action",),
    "q-learning-target": SARSA,
    "double-sarsa": SARSA,
    "double-expected-sarsa": ("action, state, each action",),
    "weighted-double-q-learning": ("action, state, max action",),
    "maxmin-q-learning": ("action, state, max action",),
    "hysteretic-q-learning": ("action, state, max action",),
    "r-learning": ("action, state, max action",),
    "differential-q-learning": ("action, state, max action",),
    "differential-sarsa": SARSA,
    "dyna-q": ("action, state, max action",),
    "r-max": ("action, each state, max action",),
    "ucb-q-learning": ("action, state, max action",),
    "ucbvi": ("action, each state, max action",),
    "psrl": ("action, each state, max action",),
    "dyna-q-plus": ("action, state, max action",),
    "prioritized-sweeping": ("action, state, max action",),
    "off-policy-monte-carlo": ("action, state, action, ..., end",),
    "gradient-bandit": ("action, end",),
    "reinforce": ("action, state, action, ..., end",),
    "reinforce-baseline": ("action, state, action, ..., end",),
    "actor-critic": ("action, state",),
    "td": TD0,
    "n-step-td": ("state, action, state, ..., action, state",),
    "monte-carlo-prediction": ("state, action, state, ..., end",),
    "off-policy-td": TD0,
    "n-step-off-policy-td": ("state, action, state, ..., action, state",),
    "off-policy-monte-carlo-prediction": ("state, action, state, ..., end",),
}
SHAPES["q-sigma"] = SHAPES["tree-backup"]
SHAPES["sarsa-lambda"] = SHAPES["sarsa-lambda-forward"] = SHAPES["true-online-sarsa-lambda"] = (
    "action, state, action",
    "action, state, action, state, action",
    "action, state, action, state, action, state, action",
    "",
    "action, state, action, ..., end",
)
SHAPES["actor-critic-lambda"] = (
    "action, state",
    "action, state, action, state",
    "action, state, action, state, action, state",
    "",
    "action, state, action, ..., end",
)
SHAPES["expected-sarsa-lambda"] = SHAPES["retrace"] = SHAPES["q-pi-lambda"] = (
    "action, state, each action",
    "action, state, action, state, each action",
    "action, state, action, state, action, state, each action",
    "",
    "action, state, action, ..., end",
)
SHAPES["tree-backup-lambda"] = (
    "action, state, each action",
    "action, state, each action, state, each action",
    "action, state, each action, state, each action, state, each action",
    "",
    "action, state, each action, ..., end",
)
SHAPES["td-lambda"] = SHAPES["true-online-td-lambda"] = SHAPES["offline-lambda-return"] = (
    "state, action, state",
    "state, action, state, action, state",
    "state, action, state, action, state, action, state",
    "",
    "state, action, state, ..., end",
)
SHAPES["q-lambda"] = (
    "action, state, max action",
    "action, state, action, state, max action",
    "action, state, action, state, action, state, max action",
    "",
    "action, state, action, ..., end",
    "action, state, action, ..., state, max action",
)
# Those with features look ahead as those with a table do.
SHAPES |= {name: SHAPES[name.replace("semi-gradient-", "")] for name in METHODS if "semi-gradient" in name}
SHAPES |= {
    "lspi": SHAPES["q-learning"],
    "deep-q-network": SHAPES["q-learning"],
    "deep-sarsa": SHAPES["sarsa"],
}
SHAPES["gradient-monte-carlo"] = SHAPES["monte-carlo-prediction"]
SHAPES |= dict.fromkeys(("lstd", "semi-gradient-off-policy-td", "gtd2", "tdc"), TD0)
SHAPES["emphatic-td"] = SHAPES["td-lambda"]
IN_WORDS = {  # what no circle shows
    "double-q-learning": "one table chooses the action, the other gives its value",
    "q-learning-target": "A' is drawn from the target policy",
    "n-step-expected-sarsa": "over the actions between",
    "n-step-off-policy-sarsa": "over the actions after A_t",
    "q-sigma": "σ = 1 samples, σ = 0 is tree backup",
    "q-pi-lambda": "its value is taken off, and the mean over actions under π is added",
    "retrace": "goes on by min(1, π(A | S) / b(A | S))",
    "double-sarsa": "Q2 gives the value where Q1 learns",
    "double-expected-sarsa": "Q2 gives the values where Q1 learns",
    "weighted-double-q-learning": "a weighted mean of both gives its value",
    "maxmin-q-learning": "the least in all tables",
    "hysteretic-q-learning": "worse than believed counts less",
    "r-learning": "from each reward the average is taken off",
    "differential-q-learning": "from each reward the average is taken off",
    "differential-sarsa": "from each reward the average is taken off",
    "off-policy-monte-carlo": "over the actions after A_t",
    "off-policy-td": "multiplied by the ratio",
    "n-step-off-policy-td": "over the actions from A_t on",
    "off-policy-monte-carlo-prediction": "over the actions from A_t on",
    "dyna-q": "from what the model remembers",
    "r-max": "By the model",
    "ucb-q-learning": "With a bonus",
    "ucbvi": "from the last step to the first",
    "psrl": "By a model that is drawn",
    "dyna-q-plus": "from what the model remembers",
    "prioritized-sweeping": "the most urgent",
    "q-lambda": "the first action A_t+n that is not greedy",
    "deep-q-network": "of an older copy",
    "deep-sarsa": "of an older copy",
}


def in_text(backup):
    return tuple(
        ", ".join(" ".join(filter(None, reversed(level))) for level in levels)
        for levels in backup.levels.values()
    )


@pytest.mark.parametrize("name", METHODS)
def test_every_registered_method_has_its_diagram(name):
    """A new line of a registry needs one. Broken once: "max" left out in Q-learning -> fails."""
    backup = of_method(METHODS[name]).backup
    assert backup, f"{name} declares no backup diagram"
    assert in_text(backup) == SHAPES[name]
    assert IN_WORDS.get(name, "").lower() in backup.words.lower()
    root = STATE if name in PREDICTION else ACTION
    assert all(levels[0].node == root for levels in backup.levels.values() if levels)


def test_the_class_that_has_no_name_has_one_too():
    assert of_method(ManyTargets).backup.levels == rl.ExpectedSarsa.backup.levels


@pytest.mark.parametrize("name", [name for name in METHODS if len(SHAPES[name]) > 1])
def test_the_weights_of_an_episode_of_four_steps_add_up_to_one(name):
    """Three columns are drawn, and the last is that of the end. Broken once: λ^(T−t) -> fails."""
    weights = [w for w in METHODS[name].backup.levels if w != DOTS and "or" not in w]
    python = str.maketrans({"−": "-", "λ": "*x", "²": "**2", "^": "**", "T": "4", "t": "0"})
    as_python = [re.sub(r"^\*|(?<=[-(] )\*", "", w.translate(python)) for w in weights]
    for lam in (0.0, 0.3, 1.0):
        assert math.isclose(sum(eval(code, {"x": lam}) for code in as_python), 1)


# --- one's own -----------------------------------------------------------------------------------------


@pytree
class Mine(rl.QLearning):
    """With an update of its own."""

    def update(self, key, state, t):
        return super().update(key, state, t)


@pytree
class Text(Mine):
    """Which says what it looks ahead to, as text."""

    backup = "action, state, each action"


@pytree
class Renamed(rl.QLearning):
    """With the update of Q-learning."""

    more: float = 0.0


def test_a_method_of_ones_own():
    """An `update` of its own inherits nothing that was said of another one. Broken once: it does -> fails."""
    assert of_method(Mine).backup is None
    assert of_method(Text()).backup == Backup("action, state, each action")
    assert of_method(Renamed).backup == rl.QLearning.backup


@pytest.mark.parametrize(
    ("backup", "message"),
    [
        ("action, stat", "Wrong: backup: the level 'stat' is unknown; did you mean 'state'?"),
        ("action, action", "Wrong: backup: in 'action, action' states and actions must take turns"),
        ("end", "states and actions must take turns, and begin and end it"),
        ("action, ...", "states and actions must take turns, and begin and end it"),
        ("action, state, min action", "before 'action' 'min' is unknown; choose one of each, max"),
        ("each action, state", "there can be one root, one end, and one '...' only"),
        ("action, ..., state, ..., end", "there can be one root, one end, and one '...' only"),
        ("action", "'action' is the root alone"),
        ("", "the level '' is unknown"),
        (Backup({"1 − λ": "action", "...": ""}), "'action' is the root alone"),
        (3, "Wrong: backup must be a Backup, or its levels as text, not 3"),
    ],
)
def test_what_is_no_diagram_is_refused(backup, message):
    wrong = type("Wrong", (Mine,), {"backup": backup})
    refused(lambda: of_method(wrong), message)


# --- on the command line -------------------------------------------------------------------------------


def test_list_shows_the_diagrams(capsys):
    assert main(["list", "--backups"]) == 0
    text = capsys.readouterr().out
    for name, cls in METHODS.items():
        assert f"{name}  " in text
        shown = "\n".join(f"  {line}" if line else "" for line in str(cls.backup).splitlines())
        assert shown in text
    assert main(["list", "--backups", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == list(METHODS)
    assert found["q-learning"] == {
        "columns": "action, state, max action",
        "diagram": SHOWN["q-learning"].strip("\n").split("\n"),
    }
    assert found["td-lambda"]["columns"] == lambda_return("state", "action, state")


def test_list_tells_of_what_is_named(capsys, tmp_path):
    own = tmp_path / "mine.py"
    own.write_text(
        "import jaxrl_tab as rl\n\n@rl.pytree\nclass Mine(rl.Sarsa):\n"
        '    """Sarsa that hopes."""\n    hope: float = rl.field(default=0.5, help="How much.")\n'
    )
    assert main(["list", "q-learning", "cliff-walking", f"{own}:Mine"]) == 0
    text = capsys.readouterr().out
    assert "q-learning  Off-policy control" in text and "●   ●   ●   max over a'" in text
    assert "Mine  Sarsa that hopes." in text and "--hope" in text and "●   A'" in text
    assert text.count("cliff-walking  ") == 2  # it is an environment and a figure
    assert "expected-sarsa" not in text
    assert main(["list", "gymnasium:FrozenLake-v1"]) == 0
    assert "--is-slippery" in capsys.readouterr().out
    assert main(["list", "td", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found) == ["prediction", "figures"]
    assert found["prediction"]["td"]["backup"] == {"columns": "state, action, state"}


def test_where_the_circles_cannot_be_shown_other_characters_are(capsys):
    text = str(rl.QLearning.backup).encode("ascii", "lookalikes").decode()
    assert text.splitlines()[2:] == ["    o       R, S'", "  / | \\", " /+-+-+\\", "@   @   @   max over a'"]


# --- as a picture --------------------------------------------------------------------------------------


def nodes(root):
    yield root.x, root.node
    for child in root.children:
        yield from nodes(child)


def inner(root):
    """The nodes just above the leaves."""
    below = [node for child in root.children for node in inner(child)]
    return below or ([root] if root.children else [])


def test_the_picture_has_the_same_nodes(tmp_path):
    """Circles, squares and arcs, within the figure. Broken once: no arc for "max" -> fails."""
    drawn = {name: cls.backup for name, cls in METHODS.items()}
    figure = plot.backups(drawn)
    (ax,) = figure.axes
    columns = [levels for backup in drawn.values() for levels in backup.levels.values() if levels]
    count = Counter(node for levels in columns for _, node in nodes(tree(levels)))
    circles = [p for p in ax.patches if isinstance(p, Circle) and p.radius > 0.02]
    solid = sum(p.get_facecolor()[0] < 0.5 for p in circles)
    assert (solid, len(circles) - solid) == (count[ACTION], count[STATE])
    assert sum(isinstance(p, Rectangle) for p in ax.patches) == count[END]
    branches = [[node for node in inner(tree(levels)) if levels[-1].over == "max"] for levels in columns]
    assert sum(isinstance(p, Arc) for p in ax.patches) == sum(map(len, branches))
    texts = [text.get_text() for text in ax.texts]
    assert {"q-learning", "max over $a'$", "$R_{t+n}$, $S_{t+n}$"} <= set(texts)
    assert r"or $\lambda ^{n−1}$" in texts
    plot.save(figure, tmp_path / "backups.svg")
    boxes = [text.get_window_extent() for text in ax.texts]
    width, height = figure.bbox.size
    assert all(box.x0 >= 0 and box.x1 <= width and box.y0 >= 0 and box.y1 <= height for box in boxes)
    apart = [
        (a, b)
        for i, a in enumerate(boxes)
        for b in boxes[:i]
        if a.shrunk(0.9, 0.5).overlaps(b.shrunk(0.9, 0.5))
    ]
    assert not apart


def test_a_weight_of_ones_own_is_drawn_as_it_is(tmp_path):
    """Whatever Matplotlib would make of it. Broken once: set as a formula in any case -> fails, by an error."""
    weights = ["σ", "50 %", "a_b", "$x", "^", "{2}", "w^(n−1)"]
    figure = plot.backups({"mine": Backup(dict.fromkeys(weights, "action, state"))})
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts[1:] == ["$σ$", "50 %", "a_b", r"\$x", "^", "{2}", "$w^{n−1}$"]
    plot.save(figure, tmp_path / "mine.png")


def test_labels_count_from_the_end_after_dots():
    (levels,) = Backup("state, action, state, ..., state, action, state").levels.values()
    assert labels(levels) == [
        *("S_t", "A_t", "R_t+1, S_t+1", ""),
        *("R_t+n-1, S_t+n-1", "A_t+n-1", "R_t+n, S_t+n"),
    ]
