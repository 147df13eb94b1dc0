"""ROS 1 bags (http://wiki.ros.org/Bags/Format/2.0)."""
