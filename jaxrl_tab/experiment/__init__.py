"""Experiments: described in a file, computed by an executor, kept in a folder."""
