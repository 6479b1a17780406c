"""How a body deforms: materials, finite elements, effects and their parameters."""
