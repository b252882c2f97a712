"""From one run to a sweep.

Its modules, from the ground up:

    budget      how long a run is, and what is recorded of it
    log         what is recorded of a run, row by row
    loop        step after step of an agent in its environment
    train       one run, checked and compiled
    provenance  what the bits of a result depend on beside the experiment
    programs    what is compiled outlives the process
    room        how much memory runs take, and so how many are computed at once
    batch       many runs as one program, on all devices
    axes        what a sweep tries of a hyperparameter: grids in steps, and random draws
    part        one method in one environment, with all its configurations and seeds
    results     what a sweep gives, with named axes, and how it is saved
    sweep       a grid of hyperparameters times seeds, in one call
    offline     learning from a log, and logging a run
"""
