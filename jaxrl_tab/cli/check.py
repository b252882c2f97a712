"""`jaxrl-tab check`: whether a student's agent is right, and which mistake is in it that is not."""

import textwrap
from pathlib import Path

from rich.markup import escape

from jaxrl_tab.cli.options import Command, Option, Place, parse
from jaxrl_tab.cli.streams import console, print_json
from jaxrl_tab.core.errors import InputError, as_path
from jaxrl_tab.course import EXERCISES, Checked, check

CHECK = Command(
    "check",
    """\
Whether an agent that somebody wrote is right, and which mistake is in it that is not.

The file holds a class with `act` and `update` in plain Python, or the function of the first exercise. The check lets it
act on scripted tasks, compares what it learns after each step with what it should, and names the mistake. The exit
code is 0 for a right agent, 1 where a mistake was found, and 2 where the file cannot be judged, as where it does not
run.

Examples:
  jaxrl-tab check --hand-out exercises
  jaxrl-tab check exercises/exercise_3_sarsa.py
  jaxrl-tab check my_agent.py --exercise q-learning
  jaxrl-tab check my_agent.py --json""",
    places=(Place("file", "[FILE]", "The file, my_agent.py.", False),),
    options=(
        Option(
            "--exercise",
            "exercise",
            'Which exercise it is for, where neither exercise = "sarsa" in the file nor the name of the class says so: '
            f"one of {', '.join(EXERCISES)}.",
            metavar="NAME",
        ),
        Option("--no-task", "no_task", "A right agent does not show on a task what it can do.", metavar=""),
        Option("--hand-out", "hand_out", "Write the files of the exercises into this folder.", metavar="DIR"),
        Option("--json", "json", "Print JSON.", metavar=""),
    ),
)


def check_command(argv: list[str]) -> int:
    places, typed = parse(CHECK, argv, {})
    file, options = places.get("file"), typed["options"]
    if "--hand-out" in options:
        if file:
            raise InputError("--hand-out writes the exercises, and checks none: leave out the file")
        return _hand_out(as_path("--hand-out", options["--hand-out"][0]))
    if not file:
        raise InputError("name a file to check, as my_agent.py; --hand-out DIR writes those of the exercises")
    exercise = options.get("--exercise", (None,))[0]
    checked = check(Path(str(file)), exercise, reward="--no-task" not in options)
    if "--json" in options:
        verdicts = [x._asdict() for x in checked.verdicts]
        own = {"right": checked.right, "mistakes": checked.mistakes, "verdicts": verdicts}
        print_json(checked._asdict() | own)
    else:
        _show(checked)
    return 0 if checked.right else 1


def _show(checked: Checked) -> None:
    out = console()
    out.print(f"[bold]{escape(checked.title)}[/]", soft_wrap=True)
    for x in checked.verdicts:
        out.print(f"{'[green]✓[/]' if x.right else '[bold red]✗[/]'} {escape(x.about)}")
        for line in x.sentences:
            text = textwrap.fill(line, out.width, initial_indent="  ", subsequent_indent="  ")
            out.print(text, markup=False, soft_wrap=True)
    out.print(f"[bold {'green' if checked.right else 'red'}]{checked.conclusion}[/]")
    for line in checked.reward:
        out.print(line, markup=False)


def _hand_out(folder: Path) -> int:
    files = [exercise.handout for exercise in EXERCISES.values()]
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; name a folder")
    for file in files:
        if (folder / file.name).exists():
            raise InputError(f"{folder / file.name} is there already; name another folder")
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        (folder / file.name).write_bytes(file.read_bytes())
    names = ", ".join(file.name for file in files)
    console().print(f"[bold]{escape(str(folder))}[/]: {names}", soft_wrap=True)
    return 0
