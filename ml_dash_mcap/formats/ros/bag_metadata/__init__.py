"""The metadata of a rosbag2, in its `metadata.yaml` and in its files, read and written."""
