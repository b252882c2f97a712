"""How fast it is beside its peers, measured side by side: `python -m benchmarks`."""
