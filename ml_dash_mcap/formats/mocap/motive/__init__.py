"""OptiTrack Motive CSV, in and out."""
