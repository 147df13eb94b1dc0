"""Motion capture: takes of bodies, markers and joints, in the files of its tools."""
