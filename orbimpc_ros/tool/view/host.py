"""Another program in place of this process, which still ends with its parent."""

from __future__ import annotations

import os
import sys

if __name__ == '__main__':
    os.execv(sys.argv[1], sys.argv[1:])
