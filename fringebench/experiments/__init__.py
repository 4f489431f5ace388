"""Experiments on a scene: whole runs, comparisons, error budgets, acceptance tests, inspection."""
