"""`python -m greybox.cli`, where the command is not installed."""

from greybox.cli import main

if __name__ == "__main__":
    main()
