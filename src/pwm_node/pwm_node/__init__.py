"""What a ROS 2 node at PWM rate needs: the wire format, the parameter table, life cycle, spinning and diagnostics."""
