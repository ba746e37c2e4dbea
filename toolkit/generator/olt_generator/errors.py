"""The one exception that users are meant to read."""


class InputError(Exception):
    """Something given from outside cannot be used.

    The message is one line: what is wrong, where (file, field, frame), and what to do. Command lines print it
    and exit with a non-zero status; no traceback is shown.
    """
