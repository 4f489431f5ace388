"""What every room needs and no physics: errors, frozen models, files written whole, memory, the LLVM library."""
