"""The plant: inverter, machine, load and sensors, in one thin node."""
