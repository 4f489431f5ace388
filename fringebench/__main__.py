"""``python -m fringebench``."""

from fringebench.cli import main

main()
