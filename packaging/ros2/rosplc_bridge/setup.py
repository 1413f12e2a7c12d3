"""Installs the package where `ros2 run` and `ros2 launch` look for it."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "rosplc_bridge"

setup(
    name=NAME,
    version=ElementTree.parse("package.xml").findtext("version"),
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", [str(path) for path in Path("launch").glob("*.launch.py")]),
        (f"share/{NAME}/config", [str(path) for path in Path("config").glob("*.yaml")]),
    ],
    # rosplc itself is installed with pip; colcon does not look at what is required here.
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The rosplc developers",
    maintainer_email="maintainers@rosplc.invalid",
    description="The rosplc bridge as a lifecycle node",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"bridge = {NAME}.main:main"]},
)
