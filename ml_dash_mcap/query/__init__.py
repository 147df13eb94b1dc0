"""From files to rows and columns: a range is planned from the indexes, fetched, decoded and merged."""
