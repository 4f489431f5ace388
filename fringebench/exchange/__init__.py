"""Data for and from other programs, and pages that show files."""
