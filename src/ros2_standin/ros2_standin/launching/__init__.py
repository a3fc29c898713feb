"""
As much of ROS 2's `launch` and `launch_ros` as plain launch files need.

`modules` lists what there is. A launch file imports it under the real names, and runs unchanged
where the real ones are installed.
"""
