"""Errors of engines and environments that are not ours, which commands print as one line."""


class EngineError(RuntimeError):
    """An engine that is not ours cannot be started, or goes wrong; says what it needs."""


class EnvError(EngineError, ValueError):
    """An environment returns what it must not; says which one it is and what is accepted."""
