"""Values without I/O: rows, their JSON, their schema, their merging."""
