"""ROS bags of both generations, in and out."""
