"""Build description for colcon (ament_python); what it depends on is in package.xml."""

from setuptools import find_packages, setup

package = "ros2_standin"

setup(
    name=package,
    version="0.1.0",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
        # Not `bin` and not `lib`: colcon would put it on PATH everywhere, before a real `ros2`.
        # setup.bash of the workspace adds this folder to the end of PATH where there is none.
        (f"share/{package}/path", ["path/ros2"]),
    ],
    zip_safe=False,
    maintainer="MFPCC maintainers",
    maintainer_email="maintainers@example.org",
    description="A small ros2 command for machines that have ROS 2 as Python packages only",
    license="Apache-2.0",
)
