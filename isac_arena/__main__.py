"""`python -m isac_arena`: the same as the command `arena`."""

from isac_arena.cli.main import main

main()
