"""The drive controller: schemes, speed loop and rotor observer, in one thin node."""
