# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What contributors meet: workflows and forms that are valid, a declaration that is true."""

import sys
from importlib.util import find_spec

import pytest
import yaml
from harness import ROOT, run

GITHUB = ROOT / '.github'
SCHEMAS = {
    'vendor.github-workflows': sorted((GITHUB / 'workflows').glob('*.yml')),
    'vendor.github-issue-forms': sorted(
        set((GITHUB / 'ISSUE_TEMPLATE').glob('*.yml')) - {GITHUB / 'ISSUE_TEMPLATE' / 'config.yml'}
    ),
    'vendor.github-issue-config': [GITHUB / 'ISSUE_TEMPLATE' / 'config.yml'],
}


def checked(schema, files):
    return run(sys.executable, '-m', 'check_jsonschema', '--builtin-schema', schema, *files)


@pytest.mark.skipif(not find_spec('check_jsonschema'), reason="pip install '.[test]' brings it")
@pytest.mark.parametrize('schema', SCHEMAS)
def test_files_for_the_host_are_as_its_schemas_have_them(schema, tmp_path):
    files = SCHEMAS[schema]
    assert files
    done = checked(schema, files)
    assert done.returncode == 0, done.stdout + done.stderr
    spoilt = tmp_path / 'spoilt.yml'
    spoilt.write_text('on: push\njobs: {test: {steps: 3}}\nbody: 3\nblank_issues_enabled: 3\n')
    done = checked(schema, [spoilt])
    assert done.returncode == 1
    assert 'Schema validation errors were encountered' in done.stdout


def test_the_workflow_runs_the_two_commands_of_the_readme():
    jobs = yaml.safe_load((GITHUB / 'workflows' / 'ci.yml').read_text())['jobs']
    runs = [step['run'] for job in jobs.values() for step in job['steps'] if 'run' in step]
    assert {run.split(' PINS')[0] for run in runs} == {'make test', 'make demo'}
    tried = {each['python'] for each in jobs['test']['strategy']['matrix']['include']}
    assert tried == {'3.10', '3.11', '3.12', '3.13'}
    pinned = [
        each['pins'] for each in jobs['test']['strategy']['matrix']['include'] if each['pins']
    ]
    assert pinned == ["'numpy==1.26.4' 'cvxpy>=1.7,<1.8'"]
