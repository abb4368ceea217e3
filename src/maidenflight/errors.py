"""The one exception that a user's mistake raises."""


class InputError(ValueError):
    """Something that the user gave is wrong.

    The message says what is wrong (with the value), what is expected and what to do; the command line prints it on one line
    and exits with code 2.
    """
