"""From the kernels to a microcontroller: the controller as a project in C."""
