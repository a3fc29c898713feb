"""Factors between the units that people use and SI units."""

import math

#: Radians per second of one turn per minute
RPM = 2.0 * math.pi / 60.0
