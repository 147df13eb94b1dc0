"""The SQLite files of rosbag2 folders."""
