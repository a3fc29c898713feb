"""One run of an experiment: the scenario, the engine without ROS, and what is stored with it."""

#: What can run an experiment: the real graph, or the same kernels without ROS.
ENGINES = ("ros", "inprocess")
