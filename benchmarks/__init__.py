"""Throughput beside peers, measured side by side in one run: `python -m benchmarks.throughput`."""
