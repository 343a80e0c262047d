"""What extreme scenes do to a render, each against an independent result and within a stated bound."""
