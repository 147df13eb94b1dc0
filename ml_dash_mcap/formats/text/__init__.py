"""Text files of any tool: their encoding, their dialect, their first lines, and their numbers."""
