"""Settings of scenes, view layers and this machine."""
