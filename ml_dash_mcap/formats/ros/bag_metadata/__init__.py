"""What rosbag2 says of a bag, in its `metadata.yaml` and in its files: read and written."""
