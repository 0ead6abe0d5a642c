"""Installs the ROS 2 package."""

from setuptools import setup

NAME = "nnql_bullet_ros"
setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/drive.launch.py"]),
    ],
    entry_points={"console_scripts": [f"drive = {NAME}.node:main"]},
)
