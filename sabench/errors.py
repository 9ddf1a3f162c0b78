"""The one exception that means: the input is wrong, and here is the sentence that says how."""


class InputError(Exception):
    """Bad input: one sentence that names the file, key or camera, what was expected and what came."""


class DeclinedError(InputError):
    """A solver cannot take a case, and says why: not a fault of either."""
