"""Qualisys Track Manager TSV files, in and out."""
