"""``python -m fringebench``."""

from fringebench.cli.app import main

main()
