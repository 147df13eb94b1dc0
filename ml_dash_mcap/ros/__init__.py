"""The world of ROS: what it calls things, and how it spells them in bytes. No files are read or written here."""
