"""`jaxrl-tab check`: the right name comes out of each mistake, and none of right agents, whatever their style."""

import json
import re
import subprocess
import sys
from pathlib import Path

import course_agents as agents
import numpy as np
import pytest
import scipy.stats

import jaxrl_tab as rl
from jaxrl_tab.cli import main
from jaxrl_tab.core.errors import InputError
from jaxrl_tab.course import EXERCISES, MISTAKES, behaviour, script, student
from jaxrl_tab.course.updates import Setting

BASED = {name: next(iter(styles.values())) for name, styles in agents.RIGHT.items()}
BASED["late"] = agents.SARSA["a step later"]
BASED |= {"remembering": agents.SARSA["remembers A'"], "box": agents.N_STEP["the book's box"]}
WRONG = {
    "sarsa": agents.OF_ONE_STEP + agents.OF_SARSA,
    "q-learning": agents.OF_ACT + agents.OF_ONE_STEP + agents.OF_Q_LEARNING,
    "remembering": agents.OF_REMEMBERING,
    "monte-carlo": agents.OF_MONTE_CARLO,
    "n-step-sarsa": agents.OF_N_STEP,
    "late": agents.OF_LATE,
    "box": agents.OF_BOX,
    "sarsa-lambda": agents.OF_LAMBDA,
    "epsilon-greedy": agents.OF_FUNCTION,
}
# Those that are looked for by default, each in the first exercise that has it; with --slow all are, everywhere.
OFTEN = {
    *("terminal", "time-limit", "draws-again", "max-target", "explores-in-target", "no-gamma", "alpha-twice"),
    *(
        "first-of-ties",
        "never-explores",
        "explores-others",
        "other-epsilon",
        "stale-action",
        "old-state-action",
    ),
    *("every-visit", "n-too-small", "over-the-time-limit", "traces-kept", "replacing", "next-reward"),
}
CASES = []
for base, changes in WRONG.items():
    for old, new, name in changes:
        marks = [] if name in OFTEN else [pytest.mark.further]
        OFTEN.discard(name)
        CASES.append(pytest.param(base, old, new, name, id=f"{base}: {name}", marks=marks))


@pytest.fixture
def checked(tmp_path):
    """What is said of a file with this text."""

    def check(text, exercise=None, reward=False):
        file = tmp_path / "my_agent.py"
        file.write_text(text)
        return rl.course.check(file, exercise, reward=reward)

    return check


def changed(text, *pairs):
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize(
    ("exercise", "style"), [(name, style) for name, styles in agents.RIGHT.items() for style in styles]
)
def test_right_agents_are_right(exercise, style, checked):
    """Broken once: an agent that learns a step later is not allowed for -> fails."""
    said = checked(agents.RIGHT[exercise][style])
    assert said.right and not said.mistakes, str(said)
    assert said.exercise == exercise


@pytest.mark.parametrize(("base", "old", "new", "name"), CASES)
def test_each_mistake_is_named(base, old, new, name, checked):
    """And nothing else. Broken once: `draws-again` is looked for first -> Q-learning's target passes for it, fails."""
    said = checked(changed(BASED[base], (old, new)), base if base in EXERCISES else None)
    assert not said.right
    assert set(said.mistakes) == ({name} if isinstance(name, str) else set(name)), str(said)


def test_each_mistake_that_can_be_named_is_tried():
    named = {
        x
        for changes in WRONG.values()
        for *_, name in changes
        for x in ([name] if isinstance(name, str) else name)
    }
    looked_for = {x for exercise in EXERCISES.values() for x in exercise.mistakes}
    looked_for |= {
        *behaviour.EXPLORES.values(),
        *behaviour.TIES,
        "other-epsilon",
        "old-state-action",
        "whole-numbers",
        "changes-values",
        "stale-action",
        "starts-elsewhere",
    } - {""}
    assert looked_for == set(MISTAKES)
    assert named == set(MISTAKES)


def test_two_mistakes_at_once_are_both_named(checked):
    """Both of the update, or one of it and one of the behaviour."""
    text = changed(
        BASED["sarsa"], ("if not terminated:", "if not (terminated or truncated):"), ("self.gamma * ", "")
    )
    assert set(checked(text).mistakes) == {"time-limit", "no-gamma"}
    text = changed(
        BASED["sarsa-lambda"], (agents.CHOICE, "int(np.argmax(values))"), ("        return next_action\n", "")
    )
    assert set(checked(text).mistakes) == {"first-of-ties", "draws-again"}


# --- where no known mistake explains it ---------------------------------------------------------------


def test_of_another_mistake_it_says_where_one_sees_it(checked):
    """Numbers by hand. Broken once: the first step of all is shown -> fails."""
    said = checked(changed(BASED["q-learning"], ("target = reward", "target = reward - 1.0 * truncated")))
    assert not said.right and not said.mistakes
    of_update = said.verdicts[-1].told
    assert re.search(
        r"(\d+) of (\d+) steps go wrong, and all of them are steps that a time limit ends", of_update[0]
    )
    s, a, r, _ = re.search(r"S = (\d), A = (\d), R = (\S+), S' = (\d), truncated", of_update[1]).groups()
    number = lambda text: float(text.replace("−", "-"))
    was, should, became = map(
        number,
        re.fullmatch(rf"Q\({s}, {a}\) was (\S+), should be (\S+), and is (\S+)\.", of_update[2]).groups(),
    )
    assert became == pytest.approx(should - 0.25, abs=1e-3)
    value = number(re.search(r"0\.875 · \(?([^)]+?)\)? − ", of_update[3]).group(1))
    assert should == pytest.approx(was + 0.25 * (number(r) + 0.875 * value - was), abs=1e-3)


def test_values_that_should_not_change_are_shown(checked):
    """Sarsa that writes to a pair of its own choice."""
    text = changed(BASED["sarsa"], ("return next_action", "self.q[5, 3] = 9.0; return next_action"))
    said = str(checked(text))
    assert "None of the known mistakes explains it." in said
    assert "Q(5, 3) was 0, should be 0, and is 9." in said
    late = changed(
        agents.SARSA["a step later"],
        ("        if self.before:", "        self.q[5, 3] = 9.0\n        if self.before:"),
    )
    assert "It shows first in episode 1, step 1: S =" in str(checked(late))


def test_values_that_grow_beyond_all_bounds(checked):
    """They say nothing of how it acts; and nobody is warned."""
    text = changed(
        BASED["q-learning"], (agents.TARGET, "(self.alpha * target - 1e200 * self.q[state, action])")
    )
    said = checked(text)
    assert [x.right for x in said.verdicts] == [True, True, False] and not said.mistakes


# --- how often -----------------------------------------------------------------------------------------


def test_probabilities_by_hand():
    row = (0.0, 2.0, 2.0, 1.0)
    law = lambda **of: behaviour.probabilities(row, 0.6, **of).tolist()
    assert law() == pytest.approx([0.15, 0.35, 0.35, 0.15])
    assert law(ties="first") == pytest.approx([0.15, 0.55, 0.15, 0.15])
    assert law(ties="last", explores="never") == [0, 0, 1, 0]
    assert law(explores="others") == pytest.approx([0.2, 0.3, 0.3, 0.2])
    assert law(explores="swapped") == pytest.approx([0.1, 0.4, 0.4, 0.1])
    assert law(explores="to the worst") == pytest.approx([0.55, 0.15, 0.15, 0.15])


def test_a_right_agent_is_refused_as_seldom_as_is_said():
    """Chi squared by SciPy; and what is said to be as improbable as p comes in a share of p, or of less."""
    for x, freedom in ((3.0, 6), (60.0, 12), (0.1, 2)):
        assert behaviour._beyond(x, freedom) == pytest.approx(scipy.stats.chi2.sf(x, freedom))
    draw, law = np.random.default_rng(0), lambda row: behaviour.probabilities(row, 0.6)
    rows, doubts = behaviour.ROWS[:2], []
    for _ in range(100):
        choices = [
            behaviour.Choice(str(row), row, int(a))
            for row in rows
            for a in draw.choice(4, behaviour.DRAWS, p=law(row))
        ]
        doubts.append(behaviour.doubt(choices, law))
    share = np.mean(np.array(doubts) < 0.1)
    assert 0 < share < 0.1 + 4 * np.sqrt(0.1 * 0.9 / 100)
    assert min(doubts) > behaviour.ERROR


def test_the_script_has_all_that_mistakes_show_in(tmp_path):
    """Ends of both kinds, states that lead to themselves, pairs that come again in an episode; Q of a last state."""
    (tmp_path / "agent.py").write_text(BASED["sarsa"])
    seen = script.record(student.load(tmp_path / "agent.py", None), EXERCISES["sarsa"])
    steps = [x.step for x in seen]
    assert sum(x.terminated for x in steps) == sum(x.truncated for x in steps) == script.EPISODES / 2
    assert sum(x.s == x.s_next for x in steps) > 20
    assert sum((x.before[x.step.s_next] != 0).any() for x in seen if x.step.terminated) > 10
    assert len({x[:2] for x in steps}) == Setting().num_states * Setting().num_actions


# --- what cannot be judged ---------------------------------------------------------------------------

INIT = "def __init__(self, num_states, num_actions, alpha, gamma, epsilon, rng):"
UNUSABLE = {
    "a syntax error": ("class Base:", "class Base", "my_agent.py cannot be imported: SyntaxError, line 4"),
    "a name": (
        "target = reward",
        "target = rewrd",
        "line 18, in update: NameError: name 'rewrd' is not defined",
    ),
    "no update": (
        "def update",
        "def learn",
        "line 15: Sarsa has no method update(self, state, action, reward,",
    ),
    "arguments": (
        ", terminated, truncated):",
        ", done):",
        "line 16: it must be possible to call update(self, state,",
    ),
    "no action": ("return next_action", "return target", "line 16: update returned"),
    "act": (
        "return self.rng.integers(len(values))",
        "return None",
        "line 9: act returned None, where an action is",
    ),
    "no table": ("self.q", "self.values", "line 5: there is no table self.q"),
    "a table": ("(num_states, num_actions)", "num_states", "line 15: self.q cannot be read as q[s, a]"),
    "constructor": (INIT, INIT.replace("num_states", "n_states"), "line 5: __init__ asks for n_states"),
    "it leaves": ("target = reward", "raise SystemExit(3)", "in update: SystemExit: 3"),
    "it asks": ("target = reward", "target = float(input())", "in update: EOFError"),
    "its name": (
        "class Sarsa",
        "class Mine",
        'line 15: say which exercise Mine is for, as in exercise = "sarsa"',
    ),
    "exercise": ("import numpy as np", 'import numpy as np; exercise = "sara"', "did you mean 'sarsa'?"),
    "two": (
        "class Sarsa(",
        "class Other(Base):\n    pass\n\nclass Sarsa(",
        "several agents, Other, Sarsa: say which",
    ),
    "none": (BASED["sarsa"], "x = 1\n", "my_agent.py has neither a class with act and update nor a function"),
    "a loop": ("target = reward", "while True: pass", "line 18, in update: it has not ended after"),
    "a loop outside": (
        "import numpy as np",
        "import numpy as np\nwhile True: pass",
        "line 3: it has not ended after",
    ),
    "it catches all": (
        "target = reward",
        "\n        while True:\n            try: sum(range(9))\n            except Exception: pass",
        "it has not ended",
    ),
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_what_cannot_be_judged_is_one_line_with_the_line_of_the_file(case, checked, monkeypatch):
    """Broken once: the last frame of all is taken, which is NumPy's -> fails."""
    monkeypatch.setattr(student, "PATIENCE", 0.15 if "loop" in case or "catches" in case else 5.0)
    old, new, message = UNUSABLE[case]
    with pytest.raises(InputError) as error:
        checked(changed(BASED["sarsa"], (old, new)))
    assert message in str(error.value) and "\n" not in str(error.value)
    assert str(error.value).startswith("my_agent.py") or case == "exercise"


def test_a_folder_is_no_agent(tmp_path, capsys):
    """Broken once: taken for a file of another kind -> fails."""
    assert main(["check", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith("is a folder: name a file; there is none of Python in it\n")
    (tmp_path / "mine.py").touch()
    assert main(["check", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith(f"name a file in it, such as {tmp_path / 'mine.py'}\n")


def test_files_beside_it_are_found_and_what_it_prints_is_not_shown(tmp_path, capsys):
    (tmp_path / "exercise_1.py").write_text(agents.EPSILON_GREEDY["numpy"])
    text = changed(
        BASED["sarsa"],
        ("import numpy as np", "import numpy as np\nfrom exercise_1 import epsilon_greedy"),
        (
            "        values = self.q[state]\n",
            "        print(state)\n        return epsilon_greedy(self.q[state], self.epsilon, self.rng)\n",
        ),
    )
    (tmp_path / "agent.py").write_text(text)
    assert rl.course.check(tmp_path / "agent.py", reward=False).right
    assert not capsys.readouterr().out
    # What was changed is run anew, and with it what it imports.
    (tmp_path / "exercise_1.py").write_text(agents.EPSILON_GREEDY["numpy"].replace("<", ">"))
    assert rl.course.check(tmp_path / "agent.py", reward=False).mistakes == ("epsilon-swapped",)


# --- as people use it --------------------------------------------------------------------------------


def test_in_a_notebook(checked):
    """A class as it is, and what is shown of it."""

    class QLearning:
        def __init__(self, num_states, num_actions):
            self.q = np.zeros((num_states, num_actions))

        def act(self, state):
            return int(self.q[state].argmax())

        def update(self, state, action, reward, next_state, terminated, truncated):
            self.q[state, action] += 0.25 * (
                reward + 0.875 * self.q[next_state].max() - self.q[state, action]
            )

    said = rl.course.check(QLearning)
    assert said.mistakes == ("first-of-ties", "never-explores", "terminal")
    assert "It bootstraps through a terminal state." in said._repr_html_() and repr(said) == str(said)
    with pytest.raises(InputError, match="the exercise epsilon-greedy wants a function"):
        rl.course.check(QLearning, "epsilon-greedy")
    with pytest.raises(InputError, match="check takes a file, a class or a function, not 3"):
        rl.course.check(3)


def test_the_command(tmp_path, capsys):
    """Its exit code says what came out. Broken once: 0 for every agent that runs -> fails."""
    file = tmp_path / "my_agent.py"
    file.write_text(BASED["q-learning"])
    assert main(["check", str(file), "--no-task"]) == 0
    assert "It is right." in capsys.readouterr().out
    file.write_text(changed(BASED["q-learning"], ("if not terminated:", "if True:")))
    assert main(["check", str(file), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert said["mistakes"] == ["terminal"] and not said["right"] and said["exercise"] == "q-learning"
    assert [x["right"] for x in said["verdicts"]] == [True, True, False]
    file.write_text("import nothing_like_this\n")
    assert main(["check", str(file)]) == 2
    assert capsys.readouterr().err.startswith(
        "jaxrl-tab: my_agent.py cannot be imported: ModuleNotFoundError, line 1"
    )


def test_the_exercises_are_handed_out(tmp_path, capsys):
    """Each of them is found to be its exercise, and to be written yet; what is there already is kept."""
    folder = tmp_path / "exercises"
    assert main(["check", "--hand-out", str(folder)]) == 0
    files = sorted(folder.iterdir())
    assert len(files) == len(EXERCISES) == 6
    for file, (name, exercise) in zip(files, EXERCISES.items(), strict=True):
        assert f"Exercise {exercise.number}:" in file.read_text() and f"check {file.name}" in file.read_text()
        assert student.load(file, None).exercise == name
        assert main(["check", str(file)]) == 2
        assert "NotImplementedError: write me" in capsys.readouterr().err
    files[0].write_text("mine")
    assert main(["check", "--hand-out", str(folder)]) == 2
    assert files[0].read_text() == "mine"


def test_a_right_agent_shows_what_it_can_do(checked):
    """Q-learning finds the shortest way along the cliff, which is worth -13."""
    said = checked(BASED["q-learning"], reward=True)
    assert "greedy policy is worth −13 from the start; the best is worth −13." in said.reward[0]
    assert said.reward[1:] == ("· " * 11 + "·",) * 2 + ("→ " * 11 + "↓", "↑ " + "· " * 10 + "G")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exercise", "least"),
    [("monte-carlo", -0.12), ("sarsa", -20), ("n-step-sarsa", -20), ("sarsa-lambda", -20)],
)
def test_the_others_learn_their_tasks_as_well(exercise, least, checked):
    said = checked(BASED[exercise], reward=True)
    worth = re.search(r"is worth (\S+) from the start", said.reward[0]).group(1)
    assert float(worth.replace("−", "-")) >= least


@pytest.mark.slow
@pytest.mark.parametrize("exercise", [name for name in EXERCISES if name != "epsilon-greedy"])
def test_right_agents_are_right_whatever_they_draw(exercise, tmp_path):
    (tmp_path / "agent.py").write_text(BASED[exercise])
    code = student.load(tmp_path / "agent.py", None)
    for seed in range(10, 16):
        assert script.diagnose(script.record(code, EXERCISES[exercise], seed), EXERCISES[exercise]) == ()
        seen = behaviour.watch(code, seed)
        for choices in (seen.starts, seen.within):
            assert behaviour.diagnose(choices, Setting().epsilon) == ((), "")


@pytest.mark.slow
def test_a_wrong_agent_is_told_so_before_jax_is_imported(tmp_path):
    """Broken once: `course.reward` is imported at the top of `course.checking` -> fails."""
    file = tmp_path / "my_agent.py"
    file.write_text(changed(BASED["sarsa"], ("        return next_action\n", "")))
    program = (
        "import sys; from jaxrl_tab.cli import main; code = main(sys.argv[1:]);"
        "assert 'jax' not in sys.modules; sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", program, "check", str(file)], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "It draws A' again: it learns from an action that it does not take." in done.stdout


PAGE = Path(__file__).parents[1] / "docs/course.md"


def test_the_page_shows_what_is_said(checked):
    """docs/course.md: its wrong agent, and what the check says of it."""
    text = PAGE.read_text(encoding="utf-8")
    (agent,) = re.findall(r"```python\n(import numpy as np\n.*?)```", text, re.DOTALL)
    (said,) = re.findall(r"```text\n(my_agent.*?)\n```", text, re.DOTALL)
    assert str(checked(agent)) == said
    looked_for = {x for exercise in EXERCISES.values() for x in exercise.mistakes}
    assert f"those of {len(looked_for)} known mistakes" in " ".join(text.split())
