"""From rows in memory to segments on disk."""
