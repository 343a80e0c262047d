"""What is wrong with a scene, said to the user."""


class SceneError(ValueError):
    """The scene cannot be rendered as described; the message says what to change."""
