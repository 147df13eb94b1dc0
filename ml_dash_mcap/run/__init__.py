"""What a run has, whichever words its user speaks: its life, tracks, parameters, metrics, logs and files."""
