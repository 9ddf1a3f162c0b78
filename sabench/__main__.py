"""Entry point of `python -m sabench`, the same as the command `sabench`."""

from sabench.cli.main import main

if __name__ == "__main__":
    main()
