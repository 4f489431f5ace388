"""Data sets: many random samples of a scene, made by many processes, verified, and read back one by one."""
