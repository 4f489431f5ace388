"""Reconstructions against truth: regions, features, acceptance bodies, error budgets."""
