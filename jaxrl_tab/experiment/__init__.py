"""Experiments: described in a file, computed by an executor, kept in a folder.

Its modules, from the ground up:

    disk       files and folders that are whole or not there
    packed     arrays in a file
    places     where in a TOML file something is wrong
    plain      values of hyperparameters as JSON and TOML have them
    instances  environments and methods that are given as instances
    tasks      what an environment has of its own: the length of its runs, and gamma
    sources    the copies of the files that somebody's own classes and tables are in
    resolve    from what a person wrote to environments, methods and values
    spec       an experiment as data: environments x methods x hyperparameters x seeds
    search     a search as data: an experiment of which only the best settings are run to the end
    samplers   who proposes the settings of a search
    growth     which runs an experiment has that those before it in its folder had not
    shards     an experiment in pieces that are computed and kept one by one
    plan       what an experiment will take: runs, shards, memory
    searching  a search, rung after rung
    comparing  methods compared on as many fresh seeds as it takes
    storage    shards on disk and their manifest
    records    what a folder says about the sessions that computed it
    found      the experiment that is found in a folder, and what it was before it grew
    progress   how far an experiment is, and how long it will go on
    executors  where shards are computed: in this process, or in others, here or on other machines
    computing  the shards that are missing are computed, and results collected
    going_on   longer runs that go on where shorter ones ended
    again      settings run again, to record what was learned on the way
    painter    a process beside this one that draws pictures
    files      the files of results in the folder
    reading    results that other tools computed
    scores     the scores of an experiment in one small file, by which others are ranked
    sides      results that are to be compared, from wherever they are
    compare    results of experiments side by side
    runner     an experiment in a folder: `run` and `resume`
"""
