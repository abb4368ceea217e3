"""python -m maidenflight: the command line."""

from maidenflight.cli import main

main()
