"""From one run to a sweep.

Its modules, from the ground up:

    budget      how long a run is, and what is recorded of it
    log         what is recorded of a run, row by row
    loop        step after step of an agent in its environment
    onward      a method with a run of it that goes on
    traced      one run as a function that is traced
    backend     by what runs are compiled: by `lanes`, or by XLA
    provenance  what the bits of a result depend on beside the experiment
    programs    compiled programs that outlive the process
    room        how much memory runs take, and so how many are computed at once
    runs        the runs of a batch, as what a program takes
    by_lanes    runs on a CPU that `lanes` compiles, in threads
    by_xla      runs that XLA compiles, on all devices
    batch       many runs at once
    within      runs in a program of somebody's own, under `jit` and `vmap`
    train       one run, checked, compiled and measured
    stepwise    one run, one step at a time
    watch       an episode of a run, step by step, and what the run learns over time
    axes        what a sweep tries of a hyperparameter: grids in steps, and random draws
    part        one method in one environment, with all its configurations and seeds
    typical     how long runs usually take, from what they are
    speeds      how fast runs were on this machine, so that a plan can say how long it takes
    counted     a method that also counts how often it took each action
    acting      by which policies runs act in the end
    explain     where the methods of a sweep lose
    results     what a sweep gives, with named axes, and how it is saved
    sweep       a grid of hyperparameters times seeds, in one call
    offline     learning from a log, and logging a run
    evaluation  what a log says about a policy that did not act, and about the one that did
"""
