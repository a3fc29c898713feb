"""What runs on the ROS graph: the drive in one process or two, recorder, replayer, black box."""
