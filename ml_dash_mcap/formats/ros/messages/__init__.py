"""Rows as ROS messages: standard ones by the meaning of fields, and one of a topic's own that loses nothing."""
