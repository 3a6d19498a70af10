"""`python -m vibrojax` is the command `vibrojax`."""

from vibrojax.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
