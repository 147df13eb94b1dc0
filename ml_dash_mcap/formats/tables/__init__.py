"""Tables: Parquet, CSV and JSON lines."""
