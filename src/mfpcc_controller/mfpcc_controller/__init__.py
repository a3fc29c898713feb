"""The drive controller: predictive current control schemes, speed loop and rotor observer, and one thin node around them."""
