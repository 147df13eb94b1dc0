"""C3D files, in and out."""
