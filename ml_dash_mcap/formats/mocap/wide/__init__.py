"""Wide CSV tables, in and out."""
