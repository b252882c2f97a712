"""Exact answers, in float64 NumPy unless it says otherwise.

Its modules, from the ground up:

    double      how exact numbers are traced: in float64, and one lane after another
    model       every outcome of every action in every state, and what leads where
    systems     sparse linear systems
    values      the linear algebra of dynamic programming over a model
    given       values and policies as they are given, checked
    visits      how often a policy comes to each state
    projected   values that are linear in features: the best of them, the TD fixed point, and their errors
    expected    what a step of linear TD is on average, and whether it diverges
    measure     what a table is worth, worked out inside a compiled program while it is learned
    optimum     the best policy of an environment, worked out once
    average     the average reward of a step: of a policy, and the largest
    iterates    evaluation and improvement, one after the other: what policy and value iteration do on their way
    horizon     the best values and actions where a task ends after a given number of steps
    linear      the best values as a linear program, and its dual: how often the best policy does what
    soft        the best policy where being unpredictable is worth something, too
    accelerated value iteration in fewer sweeps
    hardness    how hard a task is to learn: how far, how close, how long
    planning    the public side of these: values and policies of an environment that states its dynamics
    losses      what the policies of many runs lose against the best one
    affine      vectors that change while a Markov chain goes its way: their exact mean and covariance
    importance  importance sampling, judged: exact variances, and what a log is worth
"""
