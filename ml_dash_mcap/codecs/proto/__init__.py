"""Rows as protobuf messages of a type that grows with the rows: the layout, its descriptor, and the bytes of rows."""
