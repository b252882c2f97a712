"""Exact answers: dynamic programming over the states of an environment, and importance sampling without noise."""
