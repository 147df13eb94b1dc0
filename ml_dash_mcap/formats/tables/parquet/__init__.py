"""Parquet, in and out."""
