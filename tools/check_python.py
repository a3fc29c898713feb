"""Ask the Python that runs this whether the environment can be made of it (any version may run it).

Prints the interpreter to use: the one behind an environment, since .venv itself may be about to
be made anew. Or else says what is wrong, with exit code 1.
"""

import os
import sys
import sysconfig

if sys.version_info[:2] < (3, 10) or sys.version_info[:2] > (3, 13):
    sys.exit("is Python " + sys.version.split()[0] + ", not 3.10 to 3.13")
if sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
    sys.exit("is not the usual CPython, for which the packages are made")
try:
    import ensurepip  # noqa: F401
    import venv  # noqa: F401
except ImportError:
    sys.exit("lacks venv and ensurepip (on Debian and Ubuntu: apt install python3-venv)")
if os.environ.get("ROS_DISTRO"):
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        sys.exit("cannot use the ROS 2 that is sourced: " + str(error))
print(getattr(sys, "_base_executable", None) or sys.executable)
