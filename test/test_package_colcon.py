# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The installed package works from where it is installed: a colcon workspace, or a wheel."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from harness import PATIENCE, ROOT, run

NAME = 'orbimpc_ros'
NOT_SOURCES = ('.*', 'build', 'dist', 'install', 'log', 'out', '__pycache__', '*.egg-info')


def copied(folder):
    """Return a folder with a copy of the sources."""
    return Path(shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_SOURCES)))


def colcon(*words, cwd):
    script = 'import sys; from colcon_core.command import main; sys.exit(main())'
    # colcon builds packages with the first python3 on the path.
    path = f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'
    return run(
        sys.executable,
        '-c',
        script,
        *words,
        '--packages-select',
        NAME,
        cwd=cwd,
        env={**os.environ, 'PATH': path},
    )


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Return a workspace in which the package is built."""
    pytest.importorskip('colcon_ros', reason='colcon is not installed (extra test)')
    pytest.importorskip('colcon_package_selection', reason='colcon is not installed (extra test)')
    folder = tmp_path_factory.mktemp('workspace')
    copied(folder / 'src' / NAME)
    done = colcon('build', cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture
def uncompiled(tmp_path, monkeypatch):
    """Hide numba: compiling anew for an install space takes a minute."""
    (tmp_path / 'numba.py').write_text('raise ImportError("numba is left out")')
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))


def sourced(workspace, *words):
    """Return a command that runs in a shell with the workspace's environment."""
    return ['sh', '-c', '. install/setup.sh && exec "$@"', 'sh', *(str(word) for word in words)]


def prefix(workspace):
    return workspace / 'install' / NAME


def test_ros2_run_finds_the_executables(workspace):
    pytest.importorskip('ament_index_python')
    found = run(
        *sourced(workspace, sys.executable, '-c'),
        'from ament_index_python.packages import get_package_prefix as where\n'
        f'import orbimpc_ros\nprint(where("{NAME}"), orbimpc_ros.__file__, sep="\\n")',
        cwd=workspace,
    )
    where, package = found.stdout.split()
    assert where == str(prefix(workspace))
    assert package.startswith(where)
    # ros2 run finds every executable file in lib/<package>.
    files = (prefix(workspace) / 'lib' / NAME).iterdir()
    executable = {file.name for file in files if file.stat().st_mode & stat.S_IXUSR}
    assert executable == {'orbimpc', 'planner', 'sim'}


def test_share_holds_what_users_configure_and_launch(workspace):
    for root in ('config', 'launch'):
        for file in (ROOT / root).rglob('*'):
            if file.is_file() and '__pycache__' not in file.parts:
                shared = prefix(workspace) / 'share' / NAME / file.relative_to(ROOT)
                assert shared.read_bytes() == file.read_bytes()
    assert (prefix(workspace) / 'share' / NAME / 'package.xml').is_file()


@pytest.mark.usefixtures('uncompiled')
def test_installed_nodes_fly_with_the_shared_configuration(workspace, domain, monkeypatch):
    pytest.importorskip('rclpy')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    lib, share = prefix(workspace) / 'lib' / NAME, prefix(workspace) / 'share' / NAME
    words = ('--ros-args', '--params-file', share / 'config' / 'dubins.yaml')
    planner = subprocess.Popen(
        sourced(workspace, lib / 'planner', *words, '-p', 'planner:floor.shape:=none'),
        cwd=workspace,
        stderr=subprocess.DEVNULL,
    )
    try:
        done = run(
            *sourced(workspace, lib / 'sim', *words, '-p', 'sim:exit_when_done:=true'),
            cwd=workspace,
        )
        assert done.returncode == 0, done.stderr
        assert 'arrived' in done.stderr
    finally:
        planner.terminate()
        assert planner.wait(PATIENCE) == 0


def test_colcon_test_runs_pytest(workspace):
    one = (
        'test/test_mpc_geometry.py::test_planar_rotation_of_a_tilted_body_is_its_heading_from_above'
    )
    done = colcon(
        'test', '--event-handlers', 'console_direct+', '--pytest-args', one, cwd=workspace
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert ' passed' in done.stdout
    assert (workspace / 'build' / NAME / 'pytest.xml').is_file()


def test_a_wheel_carries_configuration_and_launch_files(tmp_path):
    for tool in ('pip', 'wheel'):
        pytest.importorskip(tool, reason=f'{tool} is not installed (extra test)')
    sources, wheels, site = copied(tmp_path / 'sources'), tmp_path / 'wheels', tmp_path / 'site'
    pip = (sys.executable, '-m', 'pip', '-q', '--disable-pip-version-check')
    # Without isolation nothing is downloaded: the build tools are in the extra test.
    built = run(
        *pip, 'wheel', '--no-deps', '--no-build-isolation', '-w', wheels, sources, cwd=tmp_path
    )
    assert built.returncode == 0, built.stdout + built.stderr
    (wheel,) = wheels.iterdir()
    plain = ('--no-deps', '--no-index', '--no-compile')
    placed = run(*pip, 'install', *plain, '--target', site, wheel, cwd=tmp_path)
    assert placed.returncode == 0, placed.stdout + placed.stderr
    script = (
        'from orbimpc_ros.tool import settings; print(settings.config("retrieval.yaml"))\n'
        'from orbimpc_ros.tool import cli; cli.main(["--version"])'
    )
    done = run(
        sys.executable, '-c', script, cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(site)}
    )
    path, version = done.stdout.splitlines()
    assert path == str(site / 'share' / NAME / 'config' / 'retrieval.yaml')
    assert version == 'orbimpc_ros 0.1.0'
    assert (site / 'share' / NAME / 'launch' / 'fleet.launch.py').is_file()
    assert (site / NAME / 'py.typed').is_file()
    assert (site / NAME / 'sim' / 'engines' / 'hummingbird.xml').is_file()
    # Other packages share this folder: no executable in it may be named planner or sim.
    scripts = {each.name for each in (site / 'bin').iterdir()}
    assert scripts == {'orbimpc', 'orbimpc-planner', 'orbimpc-sim'}
