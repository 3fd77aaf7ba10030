# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Each source file says whose it is and under which licence."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
STATEMENT = '# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0\n'
FOLDERS = ('docs', 'launch', 'orbimpc_ros', 'test')


def test_each_source_file_begins_with_its_copyright_statement():
    files = [ROOT / 'setup.py', *(f for name in FOLDERS for f in (ROOT / name).rglob('*.py'))]
    assert len(files) > 200
    assert [file for file in files if not file.read_text().startswith(STATEMENT)] == []
