"""The MCAP container, both ways: records, chunks, summaries, and files that may be damaged (https://mcap.dev/spec)."""
