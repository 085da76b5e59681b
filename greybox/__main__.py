"""``python -m greybox`` is the command ``greybox``."""

from greybox.cli import main

if __name__ == "__main__":
    main()
