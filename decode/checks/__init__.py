"""What is wrong with a stack, found before it is decoded."""
