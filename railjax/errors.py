"""The two ways in which a call can fail, told apart because their cure differs."""


class InputError(ValueError):
    """What the user gave cannot be used; the message is one line that names the key and the fix (exit status 2)."""


class NumericalError(RuntimeError):
    """The input is sound but the computation did not succeed; the message says which part and why (exit status 1)."""
