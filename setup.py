# SPDX-License-Identifier: Apache-2.0
"""Installs the package with pip or colcon; package.xml names the same dependencies for rosdep."""

import os

from setuptools import find_packages, setup

NAME = 'rpgd_ros'


def tree(source: str, target: str) -> list[tuple[str, list[str]]]:
    """List what is under a folder, folder by folder, as data files below `target`."""
    return [
        (folder.replace(source, target, 1), [f'{folder}/{name}' for name in sorted(names)])
        for folder, _, names in os.walk(source)
        if names
    ]


setup(
    name=NAME,
    version='0.1.0',
    description='Aligns a motion-capture system with RGB cameras from a walking person.',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'report/page/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        *tree('config', f'share/{NAME}/config'),
        *tree(f'{NAME}/launch', f'share/{NAME}/launch'),
    ],
    python_requires='>=3.11',
    install_requires=[
        'numpy>=1.26,<3',
        'opencv-python-headless>=4.6,<6',
        'PyYAML>=6.0,<7',
        'rich>=13.7,<16',
        'rosbags>=0.11.7,<0.12',
    ],
    extras_require={
        # Jazzy as wheels, for machines without an installed ROS.
        'ros': [
            'ros-jazzy-rclpy==7.1.6',
            'ros-jazzy-common-interfaces>=5.3.6,<5.4',
            'ros-rclpy[fastrtps]==7.1.6',
        ],
        # colcon test looks for pytest here, and runs nothing where it finds none.
        'test': ['pytest>=7.4,<10', 'pytest-xdist>=3.4,<4', 'hypothesis>=6.98,<7'],
        # Opens the report in a real browser, where chromium is installed.
        'browser': ['playwright>=1.40,<2'],
        'lint': ['ruff>=0.17,<0.18', 'mypy>=2.4,<3', 'types-PyYAML>=6.0,<7'],
        # Readers of the files in which Human3.6M and MPI-INF-3DHP come.
        'datasets': ['cdflib>=1.3,<2', 'scipy>=1.11,<2'],
        # evaluate --scheduler: sequences on the workers of a Dask cluster.
        'cluster': ['distributed>=2024.1'],
        # calibrate_bag --report: a page with plots.
        'report': ['plotly>=5.18,<7', 'Jinja2>=3.1,<4'],
        # Solvers that the benchmark compares ours with; it leaves out what is not there.
        'bench': ['poselib>=2.0.5,<3', 'scipy>=1.11,<2'],
        # C3D files for import_recording.
        'import': ['ezc3d>=1.5.18,<2'],
        # colcon calls commands of setup.py that setuptools 80 took away.
        'colcon': [
            'colcon-common-extensions>=0.3,<0.4',
            'colcon-ros>=0.5,<0.6',
            'setuptools>=70.1,<80',
        ],
    },
    entry_points={
        'console_scripts': [
            f'calibrator = {NAME}.apps.calibrator:main',
            f'calibrate_bag = {NAME}.apps.calibrate_bag:main',
            f'evaluate = {NAME}.apps.evaluate:main',
            f'import_recording = {NAME}.apps.import_recording:main',
            f'simulate = {NAME}.apps.simulate:main',
        ],
    },
    zip_safe=False,
)
