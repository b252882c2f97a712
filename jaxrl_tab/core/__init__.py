"""What everything stands on.

Its modules, from the ground up:

    version     the version of the package
    errors      what is said to a person who gave something wrong, and checks that need only the value
    flags       what XLA is asked for before JAX starts
    cores       how many cores there are to use
    checks      checks of the values that users give
    notebook    objects in a line, and as a table in a notebook
    pytree      frozen dataclasses that are JAX pytrees, whose fields say what they take
    describe    the parameters of a class and what they are, for help and lists
    modules     files of somebody's own, loaded by their checksum, with the files that they import
    names       what the name of an environment or a method stands for, somebody's own included
    backups     backup diagrams, as data and as text
    declared    what methods and environments declare about themselves
    types       the vocabulary: what an environment answers, what a method learns from
    rng         random numbers for the loop, one word a decision
    tables      reading and writing a table of values, and how lanes batch that
    linear      values that are linear in features of a state: reading and changing them
    credited    action values with traces: what a pair is credited with is worked out when it is read
    clock       step sizes and exploration rates as a method uses them, and the clock that they read
    families    schedules that a few numbers describe
    schedules   numbers that change with experience
    optax       schedules of optax, and functions of one's own
    optimizers  optimisers of optax, which turn the gradient of a table into a change of it
    policies    the exact probabilities of the actions, and one way to draw from them
    coverage    whether a behaviour policy takes every action that a target policy may take
    episode     the memory of the current episode, for methods that learn when it is over
    experience  logged experience, as arrays, checked
    steps       an episode step by step, with what was learned in each step
    events      the scalars in event files, as TensorBoard shows them
    memory      how many bytes things take, and where large results go
    netcdf      datasets in netCDF files
"""
