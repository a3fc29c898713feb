"""What of a node at PWM rate is made of rclpy; the rest of the package runs without ROS."""
