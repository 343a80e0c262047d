"""What a render costs in time and memory, and how cost grows with the scene."""
