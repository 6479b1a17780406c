"""Bench specimens: body, loads, materials and recordings of an experiment, from a YAML file."""
