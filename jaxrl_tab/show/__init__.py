"""What people look at.

Its modules, from the ground up:

    progress  how far something is: one kind of report everywhere
    words     names, numbers and settings as people read them
    states    the names of states
    steps     an episode as a table, a row for each step
    tasks     what people see of a task: the tables of its states, and what is exact
    places    where states cannot be counted: places at which people look at what was learned
    layout    where everything in a picture lies
    style     how pictures look: colours, markers, sizes, axes, legends
    moves     where greedy actions lead: paths, and how long they are
    curves    pictures of learning curves and of sensitivity to hyperparameters
    grids     pictures of grids: values, greedy paths, and what changes from grid to grid
    maps      a score over two hyperparameters
    panels    pictures of tasks that are no grids: panels of values and actions
    surfaces  pictures of what was learned where states cannot be counted
    rates     what a step size or an exploration rate comes to
    rate_curves pictures of that
    iterated  pictures of generalized policy iteration
    diagrams  pictures of backup diagrams
    exact_curves pictures of exact learning curves
    learning  learning over time as an animation: GIF, or a page with a slider
    plot      the public side of these, and all pictures of a sweep; `rl.plot`
    explorer  the data of the report, in which its readers look around
    explained where methods lose what they earn less than the best policy, in numbers and in words
    loss_maps pictures of that
    over_tasks methods over several environments, in a table and in words
    ranked    new methods among others over several environments, in a table and in words
    searched  what a search tried, in a table and in words
    search_curves pictures of that
    search_page what the report shows of that
    compared  results beside other results, in numbers and in words
    heat      what the report shows of that
    rows      what a chapter of the report says: its rows, notes and tables
    report    the report of an experiment, one HTML file; `rl.report`
    others    a page of results that other tools computed
    html      its templates
"""
