"""Rows on a clock that stops or jumps, under simulated time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from orbimpc_ros.lab.faults import injection as onsets
from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import STEP, Stand
from orbimpc_ros.lab.faults.injection import AFTER, SLOW
from orbimpc_ros.lab.faults.outcome import Outcome, Trial

STALE = 0.3  # [s] odom_timeout
JUMPS = {'back 0.5 s': -0.5, 'back 900 s': -900.0, 'reset to 1 s': None, 'forward 600 s': 600.0}
TO_ONE = 1.0  # [s] what a reset clock begins at
SHORT = 2  # jumps that are tried in the short form


def _stand(lab: Lab, onset: str) -> Stand:
    if onset == onsets.SOLVING:
        return lab.shared('slow, simulated time', SLOW, simulated=True)
    return lab.shared('simulated time', simulated=True)


def _onsets(long: bool) -> list[tuple[str, int]]:
    if not long:
        return [(onsets.MIDWAY, 1)]
    return [(onset, seed) for onset in onsets.ONSETS[1:] for seed in onsets.SEEDS]


def _disturbed(
    stand: Stand, case: str, onset: str, begin: Callable[[], None], wait: float
) -> Outcome:
    """Return how soon the planner is safe ``wait`` [s] after the clock is tampered with."""
    at = onsets.set_in(stand, onset, begin)
    stand.spin(wait + STEP)
    stand.spin_until_safe(at)
    stand.spin(AFTER * STEP)
    unsafe = stand.watch.broken(at)
    reaction = onsets.reaction(stand.watch.first_safe(at), at + wait)
    return Outcome(f'{case}, {onset}', unsafe, reaction)


def _frozen(lab: Lab, long: bool) -> Iterator[Outcome]:
    for onset, seed in _onsets(long):
        stand = _stand(lab, onset)
        stand.draw.seed(seed)
        outcome = _disturbed(stand, 'frozen', onset, stand.freeze, STALE)
        moving = stand.watch.moving_again(stand.frozen_at + STALE, stand.frozen_at + STALE + STEP)
        stand.thaw()
        outcome = replace(outcome, unsafe=outcome.unsafe + moving)
        yield onsets.recovered(stand, outcome)


def _jumped(lab: Lab, long: bool) -> Iterator[Outcome]:
    for onset, seed in _onsets(long):
        for case, jump in list(JUMPS.items())[: None if long else SHORT]:
            stand = _stand(lab, onset)
            stand.draw.seed(f'{case} {seed}')
            begin = _jumping(stand, jump)
            outcome = _disturbed(stand, case, onset, begin, 0.0)
            yield onsets.recovered(stand, outcome)


def _jumping(stand: Stand, jump: float | None) -> Callable[[], None]:
    """Return what makes the clock jump by a time, or back to one second."""

    def begin() -> None:
        by = TO_ONE - 1e-9 * stand.now if jump is None else jump
        stand.jump += max(by, TO_ONE - 1e-9 * stand.now)

    return begin


TRIALS = (
    Trial('frozen', 'clock frozen: safe after odom_timeout', 1.0, _frozen),
    Trial('jumps', 'clock jumps or is reset', 1.0, _jumped),
)
