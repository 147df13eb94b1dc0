"""Reads rows and columns from files: plans a range from the indexes, fetches it, decodes it, merges its rows."""
