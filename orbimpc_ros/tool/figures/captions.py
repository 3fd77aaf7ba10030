"""A flight in one line, for the head of its pictures."""

from __future__ import annotations

from orbimpc_ros.tool.io.history import History


def story(history: History) -> str:
    """Return how a flight went: a capture, or an arrival."""
    return _arrival(history) if history.values['finish'] == 'arrival' else _retrieval(history)


def _retrieval(history: History) -> str:
    near = len(history.near_misses)
    misses = f'{near} near miss{"" if near == 1 else "es"}'
    capture = history.capture
    if capture is None:
        return f'Rope not caught in {history.times[-1] - history.times[0]:.0f} s: {misses}'
    how = f'after {misses}' if near else 'on the first pass'
    return f'Rope caught at t = {capture.time - history.times[0]:.1f} s {how}'


def _arrival(history: History) -> str:
    missed, speed = history.missed
    vehicle = 'Spacecraft' if history.values['dimension'] == 3 else 'Dubins car'
    at = f' at {speed:.1e} m/s' if history.values['translation_order'] == 2 else ''
    done = 'arrives' if history.captured else 'does not arrive'
    return f'{vehicle} {done}: {missed:.1e} m from the goal{at}'
