"""ROS messages: definitions, types, and the bytes of both generations. No files are read or written here."""
