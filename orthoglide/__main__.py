"""``python -m orthoglide`` and the installed command: the command line."""

from orthoglide.cli import main

if __name__ == "__main__":
    main()
