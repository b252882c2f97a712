"""The loop and its compiler: one run, many runs in one program, sweeps and their results."""
