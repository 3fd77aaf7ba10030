# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A Chromium without a screen: opens a page and takes its picture, over a pair of pipes."""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import select
import shutil
import subprocess
import time

import numpy as np
from PIL import Image

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable', 'chrome')
# WebGL in software: nobody who runs tests need have a graphics card.
FLAGS = (
    '--headless=new',
    '--no-sandbox',
    '--disable-dev-shm-usage',
    '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader',
    '--hide-scrollbars',
    '--no-first-run',
    '--disable-background-networking',
    '--remote-debugging-pipe',
)
ANSWER = 240.0  # [s] for a command; the first frames of a busy machine are slow


def find() -> str | None:
    """Return the path of a Chromium, if there is one; CHROMIUM names one of your own."""
    chosen = os.environ.get('CHROMIUM', '')
    return next(filter(None, map(shutil.which, (chosen, *NAMES))), None)


class Refused(Exception):
    """The browser does not do what it was asked."""


class Browser:
    """A page in a browser of its own.

    Chromium's debugging protocol over pipes: JSON commands and answers, each ended by a zero byte.
    """

    def __init__(self, profile: os.PathLike, width: int, height: int) -> None:
        path = find()
        assert path, 'no Chromium'
        theirs_in, self._out = os.pipe()
        self._in, theirs_out = os.pipe()
        self._process = subprocess.Popen(
            [path, *FLAGS, f'--user-data-dir={profile}', f'--window-size={width},{height}'],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            preexec_fn=lambda: _plug(theirs_in, theirs_out),
            close_fds=False,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._numbers = itertools.count(1)
        self._unread = b''
        self._page = ''
        self._size = {'width': width, 'height': height, 'deviceScaleFactor': 1, 'mobile': False}

    def open(self, url: str) -> None:
        """Open a page, its size that of the window."""
        target = self._ask('Target.createTarget', url='about:blank')['targetId']
        attached = self._ask('Target.attachToTarget', targetId=target, flatten=True)
        self._page = attached['sessionId']
        self._ask('Emulation.setDeviceMetricsOverride', **self._size)
        self._ask('Page.navigate', url=url)

    def picture(self) -> np.ndarray:
        """Return what the page shows, shape (height, width, 3)."""
        end = time.monotonic() + ANSWER
        while True:
            try:
                data = self._ask('Page.captureScreenshot', format='png')['data']
                break
            except Refused:  # while a page is loading there is none
                assert time.monotonic() < end
                time.sleep(0.1)
        image = Image.open(io.BytesIO(base64.b64decode(data)))
        return np.asarray(image.convert('RGB'))

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._in)
        os.close(self._out)

    def _ask(self, method: str, **parameters) -> dict:
        number = next(self._numbers)
        command = {'id': number, 'method': method, 'params': parameters}
        if self._page:
            command['sessionId'] = self._page
        os.write(self._out, json.dumps(command).encode() + b'\0')
        end = time.monotonic() + ANSWER
        while True:
            answer = self._next(end)
            if answer.get('id') == number:
                if 'error' in answer:
                    raise Refused(f'{method}: {answer["error"]["message"]}')
                return answer['result']

    def _next(self, end: float) -> dict:
        while b'\0' not in self._unread:
            ready, _, _ = select.select([self._in], [], [], max(0.0, end - time.monotonic()))
            assert ready, 'the browser does not answer'
            chunk = os.read(self._in, 1 << 20)
            assert chunk, 'the browser has gone'
            self._unread += chunk
        message, _, self._unread = self._unread.partition(b'\0')
        return json.loads(message)


def _plug(theirs_in: int, theirs_out: int) -> None:
    """In the browser: commands on file 3, answers on file 4, as it expects them."""
    inward, outward = os.dup(theirs_in), os.dup(theirs_out)
    os.dup2(inward, 3)
    os.dup2(outward, 4)
