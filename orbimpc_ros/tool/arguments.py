# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Arguments that several commands have."""

from __future__ import annotations

import argparse


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Declare whose topics of a bag, or of what runs, are wanted."""
    what = 'of the vehicle, such as uav1'
    parser.add_argument('--namespace', type=_namespace, default='', metavar='NS', help=what)


def _namespace(word: str) -> str:
    name = word.strip('/')
    return f'/{name}' if name else ''


def add_set(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare changes of parameters, with what they are for."""
    help_ = f'{what}; may be repeated'
    parser.add_argument('--set', action='append', default=[], metavar='NAME=VALUE', help=help_)
