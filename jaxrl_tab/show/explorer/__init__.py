"""The data of the report, in which its readers look around.

A chapter is an environment with its methods. What its readers may want to look at is worked out here, packed, and
written into the page; what is drawn of it is up to the scripts in `html`, which know no reinforcement learning.

Its modules, from the ground up:

    packing    numbers as text in a page, a few bits for each, and back
    measures   what changes while a method learns, as curves
    scores     one number for each setting
    scene      where the states of an environment lie, and what is exact
    over_time  tables at moments of the runs of one setting
    chapter    all of an environment, within a number of bytes
"""
