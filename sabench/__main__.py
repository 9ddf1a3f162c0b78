"""`python -m sabench` is the command `sabench`."""

from sabench.cli.main import main

if __name__ == "__main__":
    main()
