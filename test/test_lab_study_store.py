# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A study's folder: whole parts or none, and nothing in it that is not this study's."""

import json
from dataclasses import replace

import pytest
from studies import SMALL, complaint

pytest.importorskip('pyarrow', reason="no pyarrow: pip install 'orbimpc_ros[study]'")

import pyarrow as pa
import pyarrow.parquet as pq

from orbimpc_ros.lab.study import columns, store, trial
from orbimpc_ros.lab.study.design import study_of
from orbimpc_ros.lab.study.store import Store


@pytest.fixture
def begun(tmp_path):
    """Return a store with runs 0 and 3 of 6."""
    kept = Store.created(tmp_path / 'study', replace(SMALL, controllers=('pursuit', 'linearised')))
    kept.begin()
    for number in (3, 0):
        kept.add(trial.flown(kept.study, [number]))
    return kept


def test_a_store_knows_what_is_missing(begun):
    resumed = Store.resumed(begun.folder)
    assert resumed.study == begun.study
    assert resumed.missing() == [1, 2, 4, 5]


def test_joined_rows_are_in_order_and_documented(begun):
    for number in (5, 4, 2, 1):
        begun.add(trial.flown(begun.study, [number]))
    begun.join()
    assert not (begun.folder / store.PARTS).exists()
    table = begun.result()
    expected = [(run, name) for run in range(6) for name in begun.study.controllers]
    assert list(zip(table['run'].to_pylist(), table['controller'].to_pylist(), strict=True)) == (
        expected
    )
    assert [field.name for field in table.schema] == [c.name for c in columns.COLUMNS]
    field = table.schema.field('closest')
    assert field.metadata == {b'description': b'least distance to the rope in the whole flight',
                              b'unit': b'm'}  # fmt: skip
    assert study_of(json.loads(table.schema.metadata[b'orbimpc_study']), '') == begun.study
    assert Store.resumed(begun.folder).missing() == []


def test_what_a_killed_run_left_is_tidied_up(begun):
    leftover = begun.folder / store.PARTS / '00000001.tmp'
    leftover.write_bytes(b'PAR1')
    assert Store.resumed(begun.folder).missing() == [1, 2, 4, 5]
    assert not leftover.exists()


def _cut(file, begun):
    file.write_bytes(file.read_bytes()[:500])


def _emptied(file, begun):
    file.write_bytes(b'')


def _of_others(file, begun):
    pq.write_table(pa.table({'run': [0]}), file)


def _without_a_controller(file, begun):
    pq.write_table(pq.read_table(file, partitioning=None).slice(0, 1), file)


def _of_another_seed(file, begun):
    study = replace(begun.study, seed=9)
    rows = trial.flown(study, [0])
    pq.write_table(pa.Table.from_pylist(rows, store.schema(study)), file)


@pytest.mark.parametrize(
    'damage', [_cut, _emptied, _of_others, _without_a_controller, _of_another_seed]
)
def test_a_damaged_part_is_named(begun, damage, capsys):
    file = begun.folder / store.PARTS / '00000000.parquet'
    damage(file, begun)
    code, line = complaint(capsys, '--resume', '-o', begun.folder)
    assert code == 2
    assert str(file) in line


@pytest.mark.parametrize(
    ('words', 'named'),
    [
        (['--runs', 7], 'runs 6, not 7'),
        (['--seed', 4], 'seed 3, not 4'),
        (['--controllers', 'pursuit'], 'controllers'),
        (['--forecast', 'hold'], 'forecast harmonic, not hold'),
        (['--set', 'max_rate=1'], 'max_rate'),
    ],
)
def test_another_configuration_is_refused_and_named(begun, words, named, capsys):
    before = (begun.folder / store.CONFIGURATION).read_text()
    code, line = complaint(capsys, '--resume', *words, '-o', begun.folder)
    assert code == 2
    assert named in line
    code, line = complaint(capsys, *words, '-o', begun.folder)
    assert code == 2
    assert 'a study with other' in line
    assert named.split()[0] in line
    assert (begun.folder / store.CONFIGURATION).read_text() == before


def test_the_same_study_wants_to_be_resumed(begun, capsys):
    words = ['--runs', 6, '--seed', 3, '--controllers', 'pursuit,linearised']
    code, line = complaint(capsys, *words, '-o', begun.folder)
    assert code == 2
    assert '--resume' in line


def test_a_folder_with_other_things_is_left_alone(tmp_path, capsys):
    (tmp_path / 'thesis.tex').write_text('precious')
    assert complaint(capsys, '-o', tmp_path)[0] == 2
    assert [p.name for p in tmp_path.iterdir()] == ['thesis.tex']


@pytest.mark.parametrize(
    ('content', 'named'),
    [('{', 'malformed'), ('{"runs": 3}', 'not a study'), (None, 'another version')],
)
def test_a_damaged_configuration_is_refused(begun, content, named, capsys):
    file = begun.folder / store.CONFIGURATION
    if content is None:
        known = json.loads(file.read_text())
        known['settings'].pop('horizon')
        content = json.dumps(known)
    file.write_text(content)
    code, line = complaint(capsys, '--resume', '-o', begun.folder)
    assert code == 2
    assert named in line
