"""What everything stands on: the vocabulary, tables, random numbers, schedules, policies."""
