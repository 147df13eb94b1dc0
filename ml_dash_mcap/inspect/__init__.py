"""A recording at a glance: its topics, runs and episodes, its gaps, and whether it is whole."""
