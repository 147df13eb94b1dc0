"""One encoding of messages a file: rows to payloads and back, payloads to columns, and schemas."""
