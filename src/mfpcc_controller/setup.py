"""Build description for colcon (ament_python); what it depends on is in package.xml."""

from setuptools import find_packages, setup

package = "mfpcc_controller"

setup(
    name=package,
    version="0.1.0",
    packages=find_packages(include=[package, f"{package}.*"]),
    package_data={package: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package}"]),
        (f"share/{package}", ["package.xml"]),
        # Executables of our own, where `ros2 run` looks: Ctrl-C is answered from their first
        # moment on.
        (f"lib/{package}", ["bin/controller"]),
    ],
    zip_safe=False,
    maintainer="MFPCC maintainers",
    maintainer_email="maintainers@example.org",
    description="The drive controller: schemes, speed loop and rotor observer, in one thin node",
    license="Apache-2.0",
)
