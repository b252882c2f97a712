"""A learning curve without luck: what docs/why.md tells of it is printed here.

Monte Carlo control plays Blackjack, 64 seeds of 10 000 games. A row of the log has the mean return of 500 games, which
is good or bad luck for the most part; and the exact value of the policy that plays, which has no luck in it but that of
having learned this policy.
"""

import numpy as np

import jaxrl_tab as rl

ROW, EVERY = 500, 5  # games in a row of the log, and rows for one that has exact values
sweep = rl.sweep(
    rl.make("blackjack"),
    rl.MonteCarlo,
    {"epsilon": 0.1},
    num_seeds=64,
    num_episodes=10_000,
    log_every=ROW,
    exact_every=EVERY,
)
ds = sweep.to_xarray()
print("games     mean return          exact value of the policy    variance: so many times smaller")
for row in range(EVERY - 1, ds.sizes["row"], EVERY):
    returns = (ds.returns / ds.episodes).isel(row=row).values
    exact = ds.policy_value.isel(row=row).values.astype(float)
    columns = (f"{x.mean():.4f} +- {x.std(ddof=1) / np.sqrt(len(x)):.4f}" for x in (returns, exact))
    print(f"{(row + 1) * ROW:<9} {'    '.join(columns):<47} {returns.var() / exact.var():>4.0f}")

soft = rl.planning.epsilon_soft(sweep.env, 0.1)[1]
optimum = rl.planning.value_iteration(sweep.env)[0]
best, explores = (rl.planning.start_value(sweep.env, v) for v in (optimum, soft))
print(f"No policy is worth more than {best:.5f}, and none that explores as much more than {explores:.5f}.")
