"""The MCAP files of rosbag2 folders."""
