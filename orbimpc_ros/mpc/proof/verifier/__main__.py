# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Verify the certificate that is named on the command line."""

import sys

from . import Refused, read, verified


def main() -> int:
    """Print what it comes to; return 1 if it does not hold, 2 if it is no certificate."""
    try:
        verdict = verified(read(sys.argv[1]))
    except (Refused, IndexError) as error:
        print(f'refused: {error}', file=sys.stderr)
        return 2
    print(
        f'claimed {verdict.claimed!r}, proved {verdict.proved!r} by {verdict.leaves} leaves:',
        'holds' if verdict.holds else 'DOES NOT HOLD',
    )
    return 0 if verdict.holds else 1


if __name__ == '__main__':
    sys.exit(main())
