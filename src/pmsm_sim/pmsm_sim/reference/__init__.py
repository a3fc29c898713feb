"""The same drive a second time, to check the first: other equations, other method, and slow.

Nothing of the plant's model is used here but the values of its parameters, and the flux map.
"""

from pmsm_sim.reference.realistic import ReferenceDrive
from pmsm_sim.reference.simple import ReferencePlant

__all__ = ["ReferenceDrive", "ReferencePlant"]
