"""OpenSim marker files, in and out."""
