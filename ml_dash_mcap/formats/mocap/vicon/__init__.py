"""Vicon CSV, in and out."""
