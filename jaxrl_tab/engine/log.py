"""What is recorded of a run, row by row."""

from typing import NamedTuple

from jaxtyping import Array, Float, Int


class Log(NamedTuple):
    """What happened, in rows: sums over so many steps (`num_steps`) or episodes (`num_episodes`).

    Attributes:
        steps: steps taken, int32 [rows].
        episodes: episodes that ended in the row, int32 [rows].
        returns: sum of their returns G = sum_t gamma^t R_{t+1}, float [rows].
        lengths: sum of their lengths in steps, int32 [rows].
        rewards: sum of the rewards of all steps, float [rows].
        greedy_value: exact value, from the start distribution, of the policy that is greedy to Q at the end
            of the row; -inf where it may go round for ever at a cost; float [rows]. None unless recorded.
        q_error: the largest |Q - Q*| at the end of the row, over the states that can be reached from the
            start and are not terminal, float [rows]. None unless recorded.
        v_error: of a method of `prediction`, the root of the mean squared error of V at the end of the row,
            over the same states, float [rows]. None unless recorded.
        recorded: what `record` gave at the end of the row, [rows] of each. None unless asked for.
    """

    steps: Int[Array, "*rows"]
    episodes: Int[Array, "*rows"]
    returns: Float[Array, "*rows"]
    lengths: Int[Array, "*rows"]
    rewards: Float[Array, "*rows"]
    greedy_value: Float[Array, "*rows"] | None = None
    q_error: Float[Array, "*rows"] | None = None
    v_error: Float[Array, "*rows"] | None = None
    recorded: dict[str, Array] | None = None
