"""Self-contained pages about studies, diagnoses and plans."""
