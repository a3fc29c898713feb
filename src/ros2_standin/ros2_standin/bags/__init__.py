"""Bags as `ros2 bag` needs them: reading them, and what is written beside the messages."""
