"""
What a recording tells of the drive it is of.

From the bottom: `steps` (samples and the voltages between them), `linear` (one step ahead by least
squares: the bound that predictions are judged against), `model` and `fit` (motor, inverter and
sensors, with confidence intervals), `delay`, `connection` (signs and phases), `identified`.
"""
