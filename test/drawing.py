# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The viewer in tests: what to install, and a recording that can be asked."""

from collections import defaultdict

import numpy as np
import pytest

from orbimpc_ros.tool import view

INSTALL = "pip install 'orbimpc_ros[view]', or with numpy 1 as docs/recording.md says"
needs_rerun = pytest.mark.skipif(not view.installed(), reason=f'needs rerun-sdk: {INSTALL}')


class Drawing:
    """Takes what is drawn in the place of a recording: archetypes by entity and time."""

    def __init__(self):
        self.drawn, self.now, self.layouts = defaultdict(list), {}, 0

    def set_time(self, _timeline, **at):
        self.now = at

    def log(self, entity, *shown, static=False):
        self.drawn[entity].append(({} if static else self.now, shown))

    def send_blueprint(self, _layout):
        self.layouts += 1

    def flush(self):
        pass

    def numbers(self, entity, which, field, place=0):
        """Return a component of what was drawn ``which``-th, as an array."""
        shown = self.drawn[entity][which][1][place]
        return np.array(getattr(shown, field).as_arrow_array().to_pylist())
