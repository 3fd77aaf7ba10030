# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The colours of every picture: Okabe and Ito's, distinct with every common colour blindness."""

BLUE, SKY, ORANGE, GREEN, RED = '#0072B2', '#56B4E9', '#E69F00', '#009E73', '#D55E00'
INK, GREY = '#222222', '#8C8C8C'


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour such as ``#0072B2``."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue
