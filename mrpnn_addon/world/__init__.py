"""The World: its light as a few directions, and its picture, which Cycles renders in a process of its own."""
