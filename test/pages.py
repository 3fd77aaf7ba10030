# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Runs the commands of documentation pages in a fresh clone: python test/pages.py.

The pages form one session in one shell, in the given order, with the output on a terminal; a page
that flies demos starts without results of earlier ones. On each page

- a block of shell commands is run line by line. Each command must exit with code 0, or with the one
  that its comment names (``# exit 1: ...``); a node in the foreground is interrupted after a while;
- the indented block after it is its output: a line ``...`` matches any lines, ``...`` within a line
  any text, a number before ``ms`` any number; other numbers must agree within 5 %;
- a YAML or Python block is saved under the last file name in the sentence before it (`boat.py`);
- other Python blocks are run; comments behind their ``print`` calls are the expected output.

Commands in ``ELSEWHERE`` are not run; each is listed with the reason. PYTHON, PINS and so on reach
make through the environment. The clone is of the last commit.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from select import select

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    'README.md',
    'docs/getting_started.md',
    'docs/proofs.md',
    'docs/recording.md',
    'docs/library.md',
)
ELSEWHERE = {
    r'git clone |cd ~': 'done already',
    r'make test': 'the other part of CI',
    r'ros2 |rosdep |colcon |\. /opt/|python3 -m venv|pip install|python -m colcon': (
        'needs ROS 2 from apt'
    ),
    r'orbimpc view': 'needs the extra view and a browser',
    r'orbimpc study': 'takes minutes, and files of yours',
}
NODE = re.compile(r'orbimpc-(planner|sim)\b.*[^&]$')
ALOFT = 8  # [s] of run time of a node in the foreground
LIMIT = 1800  # [s] for all pages
TOLERANCE = 0.05  # relative, of numbers
FENCE = re.compile(r'^```(\w*)\s*$')
FILE = re.compile(r'`([\w-]+\.(?:py|yaml))`')
NUMBER = re.compile(r'(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?')
PRINTED = re.compile(r'^print\(.*\)  # (.*)$', re.MULTILINE)
MARK = '<<<block>>>'


@dataclass
class Block:
    """A block of a page: its language, line, text, and expected output."""

    language: str
    line: int
    text: str
    file: str = ''  # name under which it is saved
    output: list[str] = field(default_factory=list)


def blocks_of(page: str) -> list[Block]:
    """Return the blocks in the text of a page."""
    found: list[Block] = []
    inside: Block | None = None
    sentence = ''
    for number, line in enumerate(page.splitlines(), 1):
        fence = FENCE.match(line)
        if inside is not None:
            if line.startswith('```'):
                inside, sentence = None, ''
            else:
                inside.text += line + '\n'
        elif fence:
            names = FILE.findall(sentence)
            name = names[-1] if names and fence[1] in ('yaml', 'python') else ''
            inside = Block(fence[1], number, '', name)
            found.append(inside)
        elif line.startswith('    ') and found and found[-1].language == 'sh':
            found[-1].output.append(line[4:])
        elif line.strip():
            sentence = f'{sentence} {line}'
        else:
            sentence = sentence if sentence.endswith(':') else ''
    for block in found:
        if block.language == 'python':
            block.output = PRINTED.findall(block.text)
    return found


def differs(expected: Sequence[str], printed: str) -> str:
    """Return how an output differs from the expected one; empty if it does not."""
    pattern, numbers = '', list[str]()
    for line in expected:
        if line.strip() == '...':
            pattern += r'(?:.*\n)*'
            continue
        for part in re.split(r'(\.\.\.|\s+)', line.rstrip()):
            if part == '...':
                pattern += '.*'
            elif part.isspace():
                pattern += r'\s+'
            else:
                numbers += NUMBER.findall(part)
                pattern += f'({NUMBER.pattern})'.join(map(re.escape, NUMBER.split(part)))
        pattern += r'\s*\n'
    found = re.fullmatch(pattern, printed)
    if found is None:
        return 'other text'
    after = [found.string[found.end(i + 1) :] for i in range(len(numbers))]
    for shown, got, rest in zip(numbers, found.groups(), after, strict=True):
        slack = TOLERANCE * max(abs(float(shown)), abs(float(got)))
        if abs(float(shown) - float(got)) > slack and not rest.startswith(' ms'):
            return f'{got} instead of {shown}'
    return ''


def script_of(blocks: Sequence[Block]) -> Iterator[str]:
    """Yield the lines of a shell script that runs blocks."""
    yield 'set -m'
    for block in blocks:
        yield f'echo {MARK!r}'
        if block.language == 'python' and not block.file:
            yield from (f"python - <<'END'\n{block.text}END", _check('python', (0,)))
        elif block.language == 'sh':
            for line in block.text.replace('\\\n', ' ').splitlines():
                yield from _run(line)


def _run(line: str) -> Iterator[str]:
    command, _, comment = line.partition(' #')
    command = command.strip()
    if not command or why_not(command):
        return
    if NODE.match(command):
        command = f'timeout --preserve-status -s INT {ALOFT} {command}'
    yield command
    yield _check(command, (0, *map(int, re.findall(r'exit (\d)', comment))))


def _check(command: str, codes: Sequence[int]) -> str:
    allowed = '|'.join(map(str, codes))
    words = command.replace("'", '"')
    return f"""case $? in {allowed}) ;; *) echo '{words}: failed' >&2; exit 1 ;; esac"""


def why_not(command: str) -> str:
    """Return why a command is not run; empty if it is run."""
    return next((why for known, why in ELSEWHERE.items() if re.match(known, command)), '')


def follow(pages: Sequence[str], clone: Path) -> list[str]:
    """Run pages in a clone; return one line for each difference or failure."""
    found = []
    for page in pages:
        blocks = blocks_of((ROOT / page).read_text())
        if any('demo' in block.text for block in blocks if block.language == 'sh'):
            found.append((page, Block('sh', 0, 'rm -rf out\n')))
        found += [(page, block) for block in blocks]
    blocks = [block for _page, block in found]
    for block in blocks:
        if block.file:
            (clone / block.file).write_text(block.text)
    environment = {k: v for k, v in os.environ.items() if k not in ('PYTHONPATH', 'VIRTUAL_ENV')}
    code, text = on_a_terminal(['bash', '-c', '\n'.join(script_of(blocks))], clone, environment)
    printed = text.split(f'{MARK}\n')[1:]
    wrong = []
    for (page, block), text in zip(found, printed, strict=False):
        difference = differs(block.output, text) if block.output else ''
        if difference:
            wrong.append(f'{page}:{block.line}: {difference}; printed:\n{text}')
    if code:
        page, block = found[len(printed) - 1]
        wrong.append(f'{page}:{block.line}: a command failed; printed:\n{printed[-1]}')
    return wrong


def on_a_terminal(
    command: Sequence[str], folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    """Run a command with its output on a terminal; return its exit code and output."""
    ours, its = os.openpty()
    child = subprocess.Popen(command, cwd=folder, env=environment, stdout=its)
    os.close(its)
    printed, end = b'', time.monotonic() + LIMIT
    while child.poll() is None or select([ours], [], [], 0.0)[0]:
        if time.monotonic() > end:
            child.kill()
        if select([ours], [], [], 1.0)[0]:
            try:
                printed += os.read(ours, 65536)
            except OSError:  # EIO: no process has the terminal open any more
                break
    return child.wait(), printed.decode(errors='replace').replace('\r\n', '\n')


def main() -> int:
    """Run the pages; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('pages', nargs='*', default=PAGES, metavar='PAGE')
    pages = parser.parse_args().pages
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / 'orbimpc_ros'
        subprocess.run(['git', 'clone', '-q', str(ROOT), str(clone)], check=True)
        wrong = follow(pages, clone)
    print('\n'.join(wrong) if wrong else f'as printed: {", ".join(pages)}')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
