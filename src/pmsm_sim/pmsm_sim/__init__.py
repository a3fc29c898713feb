"""The plant: two-level inverter, permanent-magnet synchronous machine, load and sensors, and one thin node around them."""
