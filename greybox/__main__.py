"""``python -m greybox`` is the command ``greybox``."""

from greybox.shell import main

if __name__ == "__main__":
    main()
