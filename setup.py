# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Packaging for pip and for colcon (ament_python)."""

import sys
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'orbimpc_ros'
SHARE = f'share/{NAME}'
FOR_PIP = {'bdist_wheel', 'dist_info', 'editable_wheel'}  # commands that pip builds with


def shared_files():
    """Return (destination, files) of everything under config/ and launch/."""
    folders = {}
    for root in ('config', 'launch'):
        for path in sorted(Path(root).rglob('*')):
            if path.is_file() and '__pycache__' not in path.parts:
                folders.setdefault(f'{SHARE}/{path.parent.as_posix()}', []).append(path.as_posix())
    return list(folders.items())


def executables():
    """Return the console scripts.

    colcon puts them into lib/orbimpc_ros, where ``ros2 run`` looks for ``planner`` and ``sim``. pip
    puts them into a ``bin`` that is shared with everything else: there their names are longer.
    """
    prefix = 'orbimpc-' if FOR_PIP & set(sys.argv) else ''
    return {
        'orbimpc': f'{NAME}.tool.cli:main',
        f'{prefix}planner': f'{NAME}.ros.entry:planner',
        f'{prefix}sim': f'{NAME}.ros.entry:sim',
    }


setup(
    name=NAME,
    version='0.1.0',
    description='Convex model predictive control on rotation orbitopes for ROS 2',
    license='Apache-2.0',
    maintainer='orbimpc_ros developers',
    maintainer_email='orbimpc-ros@example.org',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'sim/engines/*.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (SHARE, ['package.xml', 'requirements-jazzy.txt']),
        *shared_files(),
    ],
    python_requires='>=3.10',
    install_requires=[
        'clarabel>=0.9',
        'matplotlib>=3.6',
        'mcap>=1.1',
        'numpy>=1.26',
        'packaging>=21.0',
        'pillow>=9.0',
        'pyyaml>=6.0',
        'rosbags>=0.11',
        'scipy>=1.11',
    ],
    extras_require={
        # Apart from the others: 250 MB, and it wants a Matplotlib and a Pillow of its own.
        'basilisk': ['bsk>=2.12'],
        'bench': ['casadi', 'cvxpy>=1.7', 'gurobipy', 'pyscipopt'],
        'fast': ['numba>=0.59,<0.69'],  # tested: it is compiled with through its internals
        # MuJoCo 4.0 takes no other core than its own.
        'physics': [
            'jsbsim>=1.2',
            'mujoco==4.0.0; python_version >= "3.11"',
            'mujoco-core==4.0.0; python_version >= "3.11"',
            'rotorpy>=3.0; python_version >= "3.11"',
        ],
        'ros': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        'study': ['distributed>=2024.1'],
        'test': [
            'casadi',
            'colcon-core',
            'colcon-package-selection',
            'colcon-ros',
            'colcon-test-result',
            'cvxpy>=1.7',
            'jsbsim>=1.2',
            'mujoco==4.0.0; python_version >= "3.11"',
            'mujoco-core==4.0.0; python_version >= "3.11"',
            'mypy',
            'pytest',
            'pytest-xdist',
            'rotorpy>=3.0; python_version >= "3.11"',
            'ruff',
            'types-PyYAML',
            'wheel',
        ],
        # Its blueprints and wheels change from release to release; 0.39 is the last for 3.10.
        'view': ['rerun-sdk>=0.39,<0.42'],
    },
    entry_points={
        'console_scripts': [f'{name} = {target}' for name, target in executables().items()],
    },
    zip_safe=True,
)
