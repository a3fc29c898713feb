"""What a ROS 2 node at PWM rate needs; knows nothing of motors."""
