"""What a scene and a machine hold about rendering with MRPNN: property groups, preferences, models."""
