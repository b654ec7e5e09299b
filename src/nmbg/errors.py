"""The one exception that users see: a line that names the file and the remedy."""


class NmbgError(Exception):
    """A mistake in the input, told in one line; the command line prints it and exits with code 2."""
