"""``python -m zsight``: the command line."""

from zsight.cli import main

main()
