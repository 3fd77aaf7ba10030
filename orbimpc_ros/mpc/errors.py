"""What can go wrong, in one family: each error says what, where and what is allowed."""


class OrbimpcError(Exception):
    """Base class of every error this package raises on purpose."""


class BadInput(OrbimpcError, ValueError):
    """A value from outside is missing, malformed or out of range.

    Args:
        culprit: the field, topic or file that carries the value.
        value: the value as it came.
        allowed: what would have been accepted.
    """

    def __init__(self, culprit: str, value: object, allowed: str) -> None:
        self.culprit, self.value, self.allowed = culprit, value, allowed
        shown = value if isinstance(value, str) else repr(value)
        if len(shown) > 80:
            shown = shown[:77] + '...'
        super().__init__(f'{culprit} is {" ".join(shown.split())}; allowed: {allowed}')


class Infeasible(OrbimpcError):
    """No trajectory satisfies the constraints; the message names the one to blame."""


class SolverFailure(OrbimpcError):
    """The solver stopped without an answer that can be trusted."""
