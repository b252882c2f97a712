"""Course material: six exercises, and a check of what a student writes that names the mistake.

    rl.course.check("my_agent.py")  # or a class, in a notebook

    checking    the check of an agent as a whole, and what it says
    exercises   the six exercises, as data
    student     a student's code: found, called with care, its errors told with their line
    script      what an agent learns, step by step, against what it should, and with which mistake it would learn that
    updates     the right updates, and those with a mistake in them
    behaviour   how often an agent takes which action, against what epsilon-greedy says
    mistakes    what is said of each mistake
    reward      what a right agent can do on a task with exact values

The files that students get are in `handouts`. All but `reward` needs NumPy alone.
"""

from jaxrl_tab.course.checking import Checked, Verdict, check
from jaxrl_tab.course.exercises import EXERCISES, Exercise
from jaxrl_tab.course.mistakes import MISTAKES, Mistake

__all__ = ["EXERCISES", "MISTAKES", "Checked", "Exercise", "Mistake", "Verdict", "check"]
