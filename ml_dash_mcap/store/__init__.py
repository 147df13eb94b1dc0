"""The places of files: local files and folders, and object stores, read by ranges of bytes."""
