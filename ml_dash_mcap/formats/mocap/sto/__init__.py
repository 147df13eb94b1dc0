"""OpenSim storage files, in and out."""
