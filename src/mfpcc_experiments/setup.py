"""Build description for colcon (ament_python); what it depends on is in package.xml."""

from setuptools import find_packages, setup

package = "mfpcc_experiments"

setup(
    name=package,
    version="0.1.0",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["py.typed", "reporting/templates/*", "firmware/templates/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
        # Executables of our own, where `ros2 run` looks: Ctrl-C is answered from their first
        # moment on.
        (f"lib/{package}", ["bin/drive", "bin/record", "bin/replay"]),
        (f"share/{package}/launch", ["launch/drive.launch.py", "launch/two_axes.launch.py"]),
        ("bin", ["bin/mfpcc"]),  # on PATH, unlike what is in lib/
    ],
    zip_safe=False,
    maintainer="MFPCC maintainers",
    maintainer_email="maintainers@example.org",
    description="Experiments with the drive, and the command mfpcc",
    license="Apache-2.0",
)
