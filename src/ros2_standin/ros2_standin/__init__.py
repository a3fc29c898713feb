"""
A small `ros2` command for machines that have ROS 2 as Python packages only.

ROS 2's own command line (ros2cli, ros2launch, ros2bag) is not to be had there. This one takes the
same arguments for what it has, prints the same, and returns the same codes; for the rest it names
the real one. One verb is one file, under `commands/`; `catalogue` lists them all.
"""
