"""One run of an experiment: the scenario, the engine without ROS, and what is stored with it."""
