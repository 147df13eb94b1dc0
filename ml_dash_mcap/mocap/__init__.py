"""What is known of motion capture, without I/O: bodies, markers, joints, quaternions, frames, units."""
