"""The one exception that users are meant to read."""


class InputError(Exception):
    """Something given from outside cannot be used.

    The message is one line: what is wrong, where (file, field, frame), and what to do. Command lines print it
    and exit with a non-zero status; no traceback is shown. What files hold may be in it: line breaks become spaces,
    and what is too long to be read is left out of the middle.
    """

    def __init__(self, message: str) -> None:
        line = " ".join(message.split()) if any(character in message for character in _LINE_BREAKS) else message
        super().__init__(line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 3 :]}")


_LONGEST = 1500
_LINE_BREAKS = "\n\r\x0b\x0c\x1c\x1d\x1e\x85\u2028\u2029"
