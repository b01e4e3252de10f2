"""The three errors of the project. The command line prints any of them as one line and exits with status 1.

Whose fault it is decides the class: `DataError` yours, `DeviceError` the world's, `ModelError` the model file's.
"""


class MotorlensError(Exception):
    """Something outside the program is at fault; the message says what, where and what to do."""


class DataError(MotorlensError):
    """A recording, a column, a unit or a parameter is not usable."""


class DeviceError(MotorlensError):
    """A port, a socket or a drive is absent, taken, silent or broken."""


class ModelError(MotorlensError):
    """A sensor or motor file is damaged, altered or not what it claims to be."""
