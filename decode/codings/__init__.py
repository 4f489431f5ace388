"""Codings against indirect light, rewritten as ordinary fringes and Gray code."""
