"""The World: its light as a few directions, and its picture, rendered by Cycles in another process."""
