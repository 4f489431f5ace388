"""One path-traced pass for all patterns: sampling, guiding, the kernel, and when to stop."""
