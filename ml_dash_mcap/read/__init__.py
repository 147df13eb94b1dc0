"""From files to rows: which bytes, what is in them, in which order."""
