"""All of decoding as one kernel that reads the stack once, and the plan it executes."""
