"""Bench specimens: one YAML file says body, loads, material and what markers showed."""
