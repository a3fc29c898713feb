"""Build description for colcon (ament_python); what it depends on is in package.xml."""

from setuptools import find_packages, setup

package = "pwm_node"

setup(
    name=package,
    version="0.1.0",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="MFPCC maintainers",
    maintainer_email="maintainers@example.org",
    description="What a ROS 2 node at PWM rate needs; knows nothing of motors",
    license="Apache-2.0",
)
