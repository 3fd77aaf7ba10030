"""A run in a few lines: what was caught or reached, how often missed, what a tick cost."""

from __future__ import annotations

import numpy as np

from orbimpc_ros.tool.history import History


def text(history: History) -> str:
    """Return the summary of a run."""
    rows = {
        **_job(history),
        'ticks': str(len(history.ticks)),
        'solve time': _solve_times(history),
        'worst gap': _worst_gap(history),
        'fallbacks': str(sum(bool(fields.get('fallback')) for fields in history.flown_ticks)),
    }
    return '\n'.join(f'{name:<14}{value}' for name, value in rows.items())


def _job(history: History) -> dict[str, str]:
    if history.values['finish'] == 'arrival':
        return {'arrived': _arrival(history)}
    return {
        'captured': _capture(history),
        'near misses': _near_misses(history),
    }


def _arrival(history: History) -> str:
    missed, speed = history.missed
    done = 'yes' if history.captured else 'no'
    when = history.times[-1] - history.times[0]
    return f'{done}, {missed:.1e} m from the goal at {speed:.1e} m/s, t = {when:.0f} s'


def _capture(history: History) -> str:
    capture = history.capture
    if capture is None:
        return 'no'
    return f't = {capture.time - history.times[0]:.2f} s, {capture.distance:.3f} m from the rope'


def _near_misses(history: History) -> str:
    misses, begun = history.near_misses, history.times[0]
    if not misses:
        return '0'
    told = [f'{m.distance:.2f} m at {m.time - begun:.1f} s' for m in misses]
    return f'{len(misses)}: ' + ', '.join(told)


def _solve_times(history: History) -> str:
    times = _numbers(history, 'solve_time_ms')
    if not times.size:
        return 'unknown'
    p50, p99 = np.percentile(times, (50, 99))
    return f'p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {times.max():.1f} ms'


def _worst_gap(history: History) -> str:
    gaps = _numbers(history, 'gap')
    return f'{gaps.max():.1e}' if gaps.size else 'unknown'


def _numbers(history: History, name: str) -> np.ndarray:
    """Return the finite values of a field, over all ticks that have it."""
    values = [fields.get(name) for _, fields in history.ticks]
    numbers = np.array([v for v in values if isinstance(v, (int, float))], dtype=float)
    return numbers[np.isfinite(numbers)]
