"""Entry point of `python -m vibrojax`, which is equivalent to the command `vibrojax`."""

from vibrojax.cli import command

if __name__ == "__main__":
    command()
