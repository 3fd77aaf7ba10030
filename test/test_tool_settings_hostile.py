# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Hostile YAML and JSON: damaged files and shapes that blow up parsers; one line, no hang."""

import json

import pytest
import yaml

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import bags, files, settings
from orbimpc_ros.tool.settings import config


def read_parameters(file):
    settings.resolve(file)


def parameters():
    return config('retrieval.yaml').read_text()


def refusal(read, file):
    """Return the line in which a file is refused; None if it is not."""
    try:
        read(file)
    except BadInput as error:
        return str(error)
    return None


HALF = files.LARGEST // 2
SHAPES = {
    'many keys': (json.dumps(dict.fromkeys(map(str, range(15_000)))), ''),
    'the same key, often': ('{' + '"a":1,' * 30_000 + '"a":1}', 'twice'),
    'a number of many digits': ('a: ' + '7' * HALF, 'malformed'),
    'deep lists': ('[' * HALF, 'malformed'),
    'deep blocks': ('- ' * HALF, 'malformed'),
    'deep JSON': ('{"a":' * (HALF // 5), 'malformed'),
    'laughs': ('a: &a [x]\n' + '\n'.join(f'b{i}: [*a, *a]' for i in range(9)), 'aliases'),
    'itself': ('&a [*a]', 'aliases'),
    'a list for a key': ('? [a]\n: b', 'malformed'),
    'no time': ('a: !!timestamp x', 'malformed'),
    'no truth': ('- !!bool x', 'malformed'),
    'merged': ('<<: ' * 1000 + '{}', 'malformed'),
    'too large': ('#' * (files.LARGEST + 1), f'at most {files.LARGEST} bytes'),
}


@pytest.mark.parametrize(('text', 'culprit'), SHAPES.values(), ids=SHAPES)
def test_shapes_that_blow_up_parsers_end(tmp_path, text, culprit):
    """No assertion on time: a parser that takes the square of this never ends."""
    file = tmp_path / 'file'
    file.write_text(text)
    line = refusal(lambda path: files.read(str(path)), file)
    assert (line is None) == (culprit == '')
    assert culprit in (line or '')


BAD_PARAMETERS = {
    'a list for a number': ({'step': [1.0]}, 'step'),
    'a mapping for a number': ({'step': {'a': 1}}, 'step.a'),
    'nothing for a number': ({'step': None}, 'step is None'),
    'words in a list': ({'obstacles': ['a']}, 'obstacles'),
    'a list in a list': ({'obstacles': [[1.0]]}, 'obstacles'),
}


@pytest.mark.parametrize(('changes', 'said'), BAD_PARAMETERS.values(), ids=BAD_PARAMETERS)
def test_bad_parameters_of_a_file_are_named(tmp_path, changes, said):
    file = tmp_path / 'mine.yaml'
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': changes}}))
    line = refusal(read_parameters, file)
    assert line is not None
    assert said in line
    assert '; ' in line  # what to do about it


def test_notes_of_another_version_are_told(tmp_path):
    from orbimpc_ros.tool.bags import BagWriter

    notes = {'parameters': yaml.safe_dump({'/**': {'ros__parameters': {'warp': 9.0}}})}
    with BagWriter(tmp_path / 'bag', [], notes):
        pass
    assert bags.notes(tmp_path / 'bag') == notes
    line = refusal(settings.of_bag, tmp_path / 'bag')
    assert line is not None
    assert f"{tmp_path / 'bag'}: parameters: unknown parameter 'warp'; known: " in line
