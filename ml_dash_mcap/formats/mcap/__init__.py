"""Recordings as MCAP files again: a part of one, or its rows in another encoding."""
