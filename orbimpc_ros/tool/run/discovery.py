# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A DDS domain for one run: its own number, this machine only, and nodes that meet at once."""

from __future__ import annotations

import os
import random
import socket
from collections import deque
from pathlib import Path

DOMAINS = range(1, 102)  # beyond them DDS ports meet those that Linux hands out
# Fast DDS announces a participant five times in half a second, then every three seconds: nodes
# that start together miss each other and wait. This keeps announcing while they start.
PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="announced_often" is_default_profile="true">
    <rtps><builtin><discovery_config><initialAnnouncements>
      <count>100</count><period><sec>0</sec><nanosec>50000000</nanosec></period>
    </initialAnnouncements></discovery_config></builtin></rtps>
  </participant>
</profiles>
"""
LOG_VARIABLES = ('ROS_LOG_DIR', 'ROS_HOME')
_CLAIMS: deque[socket.socket] = deque(maxlen=6)
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # 2.x, 3.x


def isolate(folder: Path) -> int:
    """Give this process and its children a ROS domain of their own and return its number.

    Args:
        folder: takes the DDS profile, and ROS's logs unless they are to go elsewhere: no home
            folder is needed.
    """
    candidates = random.sample(DOMAINS, len(DOMAINS))
    domain = next((d for d in candidates if claimed(d)), candidates[0])
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    profile = folder / 'fastdds.xml'
    profile.write_text(PROFILE)
    for variable in PROFILE_VARIABLES:
        os.environ.setdefault(variable, str(profile))
    if not any(os.environ.get(variable) for variable in LOG_VARIABLES):
        os.environ[LOG_VARIABLES[0]] = str(folder / 'log')
    return domain


def claimed(domain: int) -> bool:
    """Return whether a domain is free, and if so keep others of this package from it.

    From the choice of a domain to its first participant takes a while, in which somebody else might
    choose it as well. A TCP port of the same number as the domain's UDP port, which DDS leaves
    alone, is held until this process ends or has claimed many more.
    """
    if not free(domain):
        return False
    claim = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        claim.bind(('127.0.0.1', 7400 + 250 * domain))
    except OSError:
        claim.close()
        return False
    if len(_CLAIMS) == _CLAIMS.maxlen:
        _CLAIMS.popleft().close()
    _CLAIMS.append(claim)
    return True


def free(domain: int) -> bool:
    """Return whether no participant of a domain lives here (RTPS 9.6.2.3: its discovery ports)."""
    for offset in (0, 10):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', 7400 + 250 * domain + offset))
            except OSError:
                return False
    return True
