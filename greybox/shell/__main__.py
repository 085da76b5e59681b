"""`python -m greybox.shell`, where the command is not installed."""

from greybox.shell import main

if __name__ == "__main__":
    main()
