# PYTHON_ARGCOMPLETE_OK
"""`python -m vibrojax` is the command `vibrojax`."""

from vibrojax.cli import command

if __name__ == "__main__":
    command()
