"""The kind of error whose text is written for the person who runs the program."""


class ForPeople(Exception):
    """What was wrong, where, and what to do: shown as it is, without a traceback."""
