"""True online Sarsa(lambda): what the forward view would learn, step by step (book, section 12.7)."""

from typing import ClassVar

from jaxrl_tab.algorithms.sarsa_lambda import SarsaLambda
from jaxrl_tab.core.backups import Backup
from jaxrl_tab.core.pytree import pytree


@pytree
class TrueOnlineSarsaLambda(SarsaLambda):
    """Sarsa(lambda) with dutch traces, which is at every step the forward view that looks as far as that step.

    delta = R + gamma Q(S', A') - Q(S, A)
    z(s, a) <- gamma lambda z(s, a) + [1 - alpha gamma lambda z(S, A)] 1[(s, a) = (S, A)]
    Q(s, a) <- Q(s, a) + alpha (delta + Q(S, A) - Q_old) z(s, a) - alpha (Q(S, A) - Q_old) 1[(s, a) = (S, A)]
    Q_old <- Q(S', A')      (book, box of section 12.7; van Seijen and Sutton 2014)

    It is `SarsaLambda(trace="dutch")`, by its name. A' is drawn from the behaviour policy before the update, and is the
    action that is then taken.
    """

    trace: ClassVar = "dutch"  # pyright: ignore[reportIncompatibleVariableOverride]
    offline: ClassVar = False  # pyright: ignore[reportIncompatibleVariableOverride]

    backup: ClassVar[Backup] = Backup(
        SarsaLambda.backup.columns,
        "As far as the episode has come, traces carry each error back to exactly this.",
    )
