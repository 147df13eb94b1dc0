"""The parts of a run, for ml-dash's and dreamlake's interfaces: life, tracks, parameters, metrics, logs and files."""
