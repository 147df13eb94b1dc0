"""Rows as ROS messages: standard ones by the meaning of fields, and a message of the topic's own that loses nothing."""
