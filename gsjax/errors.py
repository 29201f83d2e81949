"""The one exception that means: the input is at fault, and here is how."""


class InputError(ValueError):
    """Unusable input. Its message is one line that names the file (or option) and the fault.

    The command line prints the message and exits with code 2; as a library it is an ordinary `ValueError`.
    """
