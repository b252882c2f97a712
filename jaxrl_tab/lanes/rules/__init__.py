"""What each primitive of JAX means: one rule for each, in terms of single numbers.

A rule takes the code that is written, the equation and its arguments as `arrays`, and gives the result. To add a
primitive: say which number of the result comes from which numbers of the arguments, and give its test a case
(tests/test_lanes_rules.py), which compares it with XLA.

    numbers     number by number: arithmetic, comparisons, functions
    places      the same numbers at other places: reshape, slice, concatenate
    indexing    reading and writing at an index: dynamic_slice, gather, scatter
    sums        along axes: sums, products, maxima
    sorting     sort, top_k
    loops       while, scan, cond
    keys        random keys and bits

The results have XLA's bits, but for the last one or two where XLA itself is not of one mind:

    sums        of more than 4096 numbers in all lanes together, or along several axes: XLA takes another order;
                and in such maxima it loses NaN, which is kept here
    products    that are added: XLA rounds both at once or not, depending on what it works out together
    x / sqrt(y) it takes the processor's approximate root, which each maker has its own of
"""

from jaxrl_tab.lanes.rules import indexing, keys, loops, numbers, places, sorting, sums

__all__ = ["indexing", "keys", "loops", "numbers", "places", "sorting", "sums"]
