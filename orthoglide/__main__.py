"""``python -m orthoglide``: the command line."""

from orthoglide.cli import main

main()
