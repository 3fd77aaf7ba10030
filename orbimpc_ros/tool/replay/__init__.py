# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc replay``: a bag's inputs solved again, tick by tick, and compared with its outputs."""

from __future__ import annotations

import argparse

from orbimpc_ros.tool.arguments import add_namespace, add_set


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('bag', metavar='BAG', help='its folder, .mcap or .db3 file')
    parser.add_argument(
        '--params', metavar='FILE', help='parameters; by default those that the bag was made with'
    )
    add_set(parser, 'override a parameter: what if?')
    parser.add_argument(
        '--tick', type=int, metavar='K', help='show this tick alone, recorded and replayed'
    )
    add_namespace(parser)


def run(args: argparse.Namespace) -> int:
    """Solve a bag's inputs again, compare, report; 0 if nothing differs beyond the tolerances."""
    from orbimpc_ros.tool.replay import report  # needs ROS, which --help does not

    return report.run(args)
